"""The C++ planner's numbers: the committed set is met to the last bit, and the command that replays sets says so."""

import json
import os
import shutil

import numpy as np
import pytest
import replay_golden

HERE = os.path.dirname(os.path.abspath(__file__))
GOLDEN, GOLDEN_DWA = os.path.join(HERE, "golden"), os.path.join(HERE, "golden_dwa")
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


@pytest.mark.parametrize(("field", "value"), [("cost", 1.0), ("points", 3), ("thetav", 0.1)])
def test_another_winner_is_found(tmp_path, field, value):
    def change(manifest):
        manifest["scenarios"][0]["expected"]["best"][field] = value

    assert replay_golden.main([small_set(tmp_path, change)]) == 1


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


@pytest.mark.parametrize("what", DWA_CHANGES)
def test_one_number_of_the_dwa_planner_is_found(tmp_path, what):
    """Every kind looks at its numbers: the scenario as it is passes, with one of them changed it does not."""
    scenario, name, place = DWA_CHANGES[what]

    def change(arrays):
        array = arrays["%s/%s" % (scenario, name)]
        array[place] += 1 if array.dtype.kind in "iu" else 2e-9 + 4e-6 * (array.dtype == np.float32)

    assert replay_golden.main([small_set(tmp_path, source=GOLDEN_DWA, chosen=(scenario,))]) == 0
    assert replay_golden.main([small_set(tmp_path, lambda m: None, change, GOLDEN_DWA, (scenario,))]) == 1


def test_one_last_bit_of_a_sample_is_found(tmp_path):
    def change(arrays):
        samples = arrays["dwa_000/samples"]
        samples[7, 5] = np.nextafter(samples[7, 5], 100.0)

    assert replay_golden.main([small_set(tmp_path, change_arrays=change)]) == 1


def damaged(name, content):
    def damage(folder):
        shutil.copytree(GOLDEN, folder)
        with open(os.path.join(folder, name), "wb") as file:
            file.write(content)

    return damage


def cut_short(folder):
    shutil.copytree(GOLDEN, folder)
    with open(os.path.join(folder, "arrays.npz"), "r+b") as file:
        file.truncate(1000000)


def without_a_field(folder):
    os.mkdir(folder)
    small_set(folder, lambda manifest: manifest["scenarios"][0]["inputs"].pop("pose"))


def without_an_array(folder):
    os.mkdir(folder)
    small_set(folder, change_arrays=lambda arrays: arrays.pop("dwa_000/plan"))


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda folder: None, "is not there"),
        (os.mkdir, "is not there"),
        (damaged("manifest.json", b"{"), "cannot be read"),
        (damaged("manifest.json", b"[1]"), "format"),
        (damaged("manifest.json", b'{"format": "planner-golden-1", "scenarios": []}'), "no scenarios"),
        (damaged("arrays.npz", b"not an archive"), "cannot be read"),
        (cut_short, "cannot be read"),
        (without_a_field, "pose"),
        (without_an_array, "plan"),
    ],
)
def test_bad_sets_are_one_line(make, word, tmp_path, capsys):
    folder = tmp_path / "set"
    make(folder)
    assert replay_golden.main([str(folder)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert word in lines[0]
