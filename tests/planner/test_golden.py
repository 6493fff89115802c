"""The C++ planner's numbers: the committed set is met to the last bit, and the command that replays sets says so."""

import copy
import json
import os

import numpy as np
import pytest

from tests import replay_golden
from tests.support import ROOT

GOLDEN, GOLDEN_DWA = str(ROOT / "tests" / "golden"), str(ROOT / "tests" / "golden_dwa")
COUNTS = {
    GOLDEN: {"dwa": 150, "dwa_edge": 54, "inflation": 30, "navfn": 30, "rollout": 15},
    GOLDEN_DWA: {
        "dwa": 25,
        "dwa_edge": 44,
        "rollout": 4,
        "drive": 8,
        "stop_rotate": 44,
        "local_plan": 7,
        "local_plan_tf": 1,
    },
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


THREE = ("dwa_000", "infl_001", "nav_000")


def small_set(folder, change_json=lambda m: None, change_arrays=lambda a: None, source=GOLDEN, chosen=THREE):
    """A set of some scenarios, changed as asked for."""
    with open(os.path.join(source, "manifest.json"), encoding="utf-8") as file:
        manifest = json.load(file)
    manifest["scenarios"] = [s for s in manifest["scenarios"] if s["id"] in chosen]
    with np.load(os.path.join(source, "arrays.npz")) as archive:
        arrays = {
            "%s/%s" % (s["id"], name): archive["%s/%s" % (s["id"], name)]
            for s in manifest["scenarios"]
            for name in s["arrays"]
        }
    change_json(manifest)
    change_arrays(arrays)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    np.savez_compressed(folder / "arrays.npz", **arrays)
    return str(folder)


def test_a_line_per_kind_and_status_0(tmp_path, capsys):
    assert replay_golden.main([small_set(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "%-13s    1 scenarios,    0 mismatches, largest difference 0" % kind for kind in ("dwa", "inflation", "navfn")
    ]


def test_one_changed_byte_is_found(tmp_path, capsys):
    def change(arrays):
        arrays["infl_001/costmap"][3, 5] ^= 1

    assert replay_golden.main([small_set(tmp_path, change_arrays=change)]) == 1
    out, err = capsys.readouterr()
    assert "inflation        1 scenarios,    1 mismatches, largest difference 1" in out
    assert "infl_001: costmap by 1" in err


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
        changed, values = copy.copy(scenario), scenario.array(name).copy()
        values[place] += 1 if values.dtype.kind in "iu" else 2e-9 + 4e-6 * (values.dtype == np.float32)
        changed.array = lambda wanted, own=scenario, n=name, v=values: v if wanted == n else own.array(wanted)
        assert replay_golden.replay(changed), what


@pytest.mark.parametrize(("name", "word"), [("arrays.npz", "cannot be read"), ("manifest.json", "is not there")])
def test_bad_sets_are_one_line(name, word, tmp_path, capsys):
    folder = small_set(tmp_path)
    (tmp_path / name).write_bytes(b"")
    if name == "manifest.json":
        (tmp_path / name).unlink()
    assert replay_golden.main([folder]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert word in line
