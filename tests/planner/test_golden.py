"""Test that the planners match committed results (golden vectors), of C++ or of slow reference
implementations, to the last bit.
"""

import pytest

from tests.planner import replay_golden
from tests.support import ROOT

GOLDEN = str(ROOT / "tests" / "golden")
GOLDEN_DWA = str(ROOT / "tests" / "golden_dwa")
DRAWN = str(ROOT / "tests" / "golden_drawn")
# Number of scenarios of each kind: a set that is cut short must not pass.
COUNTS = {
    GOLDEN: {"dwa": 150, "dwa_edge": 54, "inflation": 30, "navfn": 30, "rollout": 15},
    GOLDEN_DWA: dict(
        dwa=25,
        dwa_edge=44,
        rollout=4,
        drive=8,
        stop_rotate=44,
        local_plan=7,
        local_plan_tf=1,
    ),
    DRAWN: {"dwa": 200, "inflation": 60, "navfn": 106},
}


@pytest.fixture(scope="module")
def scenarios():
    """Return the scenarios of each folder, which are read once."""
    return {folder: replay_golden.load(folder) for folder in COUNTS}


@pytest.mark.parametrize(
    ("folder", "kind"), [(folder, kind) for folder in COUNTS for kind in COUNTS[folder]]
)
def test_every_number_equals_the_committed_one(folder, kind, scenarios):
    of_kind = [scenario for scenario in scenarios[folder] if scenario.kind == kind]
    assert len(of_kind) == COUNTS[folder][kind]
    differing = {}
    for scenario in of_kind:
        differences = replay_golden.replay(scenario)
        if differences:
            differing[scenario.id] = differences
    assert differing == {}
