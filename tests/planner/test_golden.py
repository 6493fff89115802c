"""The C++ planner's numbers: the committed set is met to the last bit, and the command that replays sets says so."""

import copy

import numpy as np
import pytest

from tests import replay_golden
from tests.support import ROOT

GOLDEN, GOLDEN_DWA, DRAWN = (str(ROOT / "tests" / name) for name in ("golden", "golden_dwa", "golden_drawn"))
COUNTS = {
    GOLDEN: {"dwa": 150, "dwa_edge": 54, "inflation": 30, "navfn": 30, "rollout": 15},
    GOLDEN_DWA: dict(dwa=25, dwa_edge=44, rollout=4, drive=8, stop_rotate=44, local_plan=7, local_plan_tf=1),
    DRAWN: {"dwa": 200, "inflation": 60, "navfn": 102},
}


@pytest.fixture(scope="module")
def scenarios():
    return {folder: replay_golden.load(folder) for folder in COUNTS}


@pytest.mark.parametrize(("folder", "kind"), [(folder, kind) for folder in COUNTS for kind in COUNTS[folder]])
def test_every_number_equals_the_cpp_one(folder, kind, scenarios):
    mine = [scenario for scenario in scenarios[folder] if scenario.kind == kind]
    assert len(mine) == COUNTS[folder][kind]
    differing = {scenario.id: found for scenario in mine for found in [replay_golden.replay(scenario)] if found}
    assert not differing


def changed(scenario, name, values):
    """The scenario with other values in one of its arrays."""
    made = copy.copy(scenario)
    made.array = lambda wanted: values if wanted == name else scenario.array(wanted)
    return made


DWA_CHANGES = {  # scenario, array, place: a number that is changed a little
    "a sample": ("dwa_000", "samples", (3, 2)),
    "a critic": ("dwa_000", "critics", (400, 4)),
    "a grid": ("dwa_000", "goal_front_dist", (5, 5)),
    "where scoring ended": ("dwa_000", "cut", (100,)),
    "a command of a free run": ("roll_001", "rollout", (30, 5)),
    "a flag of a free run": ("roll_001", "rollout_state", (30, 6)),
    "a command of a drive": ("drive_000", "steps_out", (40, 9)),
    "the rotating mark": ("stop_000_plain", "steps_out", (2, 17)),
    "a point of the cut plan": ("plan_000_along", "local_plans", (7, 2)),
    "a point in another frame": ("plantf_001", "local_plans", (7, 0)),
}


def test_one_number_of_the_dwa_planner_is_found(scenarios):
    """Every kind looks at its numbers: the scenario as it is passes, with one of them changed it does not."""
    for what, (identity, name, place) in DWA_CHANGES.items():
        (scenario,) = [scenario for scenario in scenarios[GOLDEN_DWA] if scenario.id == identity]
        assert not replay_golden.replay(scenario), what
        values = scenario.array(name).copy()
        values[place] += 1 if values.dtype.kind in "iu" else 2e-9 + 4e-6 * (values.dtype == np.float32)
        assert replay_golden.replay(changed(scenario, name, values)), what


def test_the_command_names_what_differs(scenarios, capsys, monkeypatch):
    (inflation,) = [scenario for scenario in scenarios[GOLDEN] if scenario.id == "infl_001"]
    mine = [inflation]
    monkeypatch.setattr(replay_golden, "load", lambda folder: mine)
    assert replay_golden.main([GOLDEN]) == 0
    said = "%-13s    1 scenarios,    %d mismatches, largest difference %d\n"
    assert capsys.readouterr().out == said % ("inflation", 0, 0)
    costmap = inflation.array("costmap").copy()
    costmap[3, 5] ^= 1
    mine[:] = [changed(inflation, "costmap", costmap)]
    assert replay_golden.main([GOLDEN]) == 1
    out, err = capsys.readouterr()
    assert out == said % ("inflation", 1, 1)
    assert "infl_001: costmap by 1" in err
