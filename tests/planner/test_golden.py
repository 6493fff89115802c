"""Test that the planners match committed results of the C++ planners (golden vectors) to the last
bit.
"""

import pytest

from tests.planner import replay_golden
from tests.support import ROOT

GOLDEN, GOLDEN_DWA, DRAWN = (
    str(ROOT / "tests" / name) for name in ("golden", "golden_dwa", "golden_drawn")
)
COUNTS = {
    GOLDEN: {"dwa": 150, "dwa_edge": 54, "inflation": 30, "navfn": 30, "rollout": 15},
    GOLDEN_DWA: dict(
        dwa=25, dwa_edge=44, rollout=4, drive=8, stop_rotate=44, local_plan=7, local_plan_tf=1
    ),
    DRAWN: {"dwa": 200, "inflation": 60, "navfn": 106},
}


@pytest.fixture(scope="module")
def scenarios():
    return {folder: replay_golden.load(folder) for folder in COUNTS}


@pytest.mark.parametrize(
    ("folder", "kind"), [(folder, kind) for folder in COUNTS for kind in COUNTS[folder]]
)
def test_every_number_equals_the_cpp_one(folder, kind, scenarios):
    mine = [scenario for scenario in scenarios[folder] if scenario.kind == kind]
    assert len(mine) == COUNTS[folder][kind]
    replayed = {scenario.id: replay_golden.replay(scenario) for scenario in mine}
    assert not {name: differences for name, differences in replayed.items() if differences}
