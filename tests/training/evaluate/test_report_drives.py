"""Tests of the page of drives: driven paths, no other file needed, all names escaped."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from applr_ros1.policy.parameter_space import SPACE
from tests.support.browser import focused, needs_browser, opened, shown_methods
from tests.support.drives import driven
from tests.support.pages import data_of
from tests.support.runs import SETTINGS
from training.evaluate import drives_page
from training.evaluate.report import write
from training.evaluate.table import TrialTable
from training.evaluate.trial import Result, plan_trials

# Six seconds at 20 Hz on a curve; the numbers are arbitrary, but no two rows are alike.
TIME = 0.05 * np.arange(1, 123)
SPEED = 0.3 + 0.01 * TIME
# x, y, yaw [m, m, rad]
POSE = np.column_stack([-2.25 + np.sin(TIME), 4.0 + TIME, 3.0 + 0.1 * TIME])
TRACE = driven(
    TIME,
    POSE,
    twist=np.column_stack([SPEED, np.zeros(len(TIME))]),
    theta=[SPACE.theta0, SPACE.high],
    decided=[0.0, 1.0],
)
METHODS = ("dwa", "mine", "quiet")
WORLD = "generated:7"


@pytest.fixture
def folder(tmp_path):
    """Return the folder of an evaluation in a built-in world. The method "quiet" has no traces."""
    plan = plan_trials(
        [(WORLD, WORLD)],
        list(zip(METHODS, METHODS)),
        trials=2,
        seed=0,
        traces=2,
    )
    store = TrialTable(tmp_path, dict(SETTINGS, worlds=[WORLD], world_specs=[WORLD]))
    for trial in plan:
        result = Result(
            time_s=6.1,
            decisions=3,
            path_length_m=6.0,
            route_m=7.0,
        )
        if trial.method == "dwa":
            result = replace(result, success=True, reason="finished")
        else:
            result = replace(result, collided=True, reason="</script>")
        trace = b"" if trial.method == "quiet" else TRACE.pack()
        store.add(trial, result, trace)
    return tmp_path


def test_the_page_has_the_driven_paths(folder):
    report_page = Path(write(folder)).read_text()
    drives_file = folder / "report" / drives_page.FILE
    page_text = drives_file.read_text(encoding="utf-8")
    assert 'href="drives.html"' in report_page
    assert 'href="index.html"' in page_text  # link back to the report
    assert not re.search(r'src=|@import|url\(|href="https?:', page_text)
    page_data = data_of(page_text)
    method_names = [method["name"] for method in page_data["methods"]]
    assert method_names == list(METHODS)
    (world,) = page_data["worlds"]
    assert world["name"] == WORLD

    # Methods and trials by number
    numbers = [(drive["m"], drive["k"]) for drive in world["drives"]]
    assert numbers == [(0, 0), (0, 1), (1, 0), (1, 1)]
    dwa_drive = world["drives"][0]
    assert dwa_drive["ok"] is True
    assert dwa_drive["hit"] == ""
    assert dwa_drive["why"] == "finished"
    other_drive = world["drives"][2]
    assert other_drive["ok"] is False
    assert other_drive["why"] == "</script>"

    # The page has every fourth row, and the last one. Poses are changes in hundredths.
    shown_rows = [*range(0, 121, 4), 121]
    shown_poses = np.cumsum(dwa_drive["p"], axis=0) / 100.0
    np.testing.assert_allclose(shown_poses, POSE[shown_rows], atol=0.0051)
    np.testing.assert_allclose(dwa_drive["v"], 100 * SPEED[shown_rows], atol=0.6)
    assert dwa_drive["at"] == [0, 100]
    assert dwa_drive["theta"][1] == SPACE.high.tolist()

    # The view contains the drives.
    min_x, min_y, max_x, max_y = np.array(world["view"]) / 100.0
    x, y, _ = shown_poses.T
    assert min_x < x.min() < x.max() < max_x
    assert min_y < y.min() < y.max() < max_y

    # Posts in millimetres
    circles = np.array(world["circles"]) / 1000.0
    assert len(circles) > 50
    assert circles[:, 2] == pytest.approx(0.075, abs=0.001)
    assert world["finish"] == 1000


def test_without_traces_there_is_no_page(folder):
    for trace_file in (folder / "traces").iterdir():
        trace_file.unlink()
    assert "drives.html" not in Path(write(folder)).read_text()
    assert not (folder / "report" / drives_page.FILE).exists()


@needs_browser
def test_keys_choose_a_trial_play_and_hide_a_method(folder):
    write(folder)
    with opened(folder / "report" / drives_page.FILE) as page:
        assert page.get_by_text("0.0 of 6.2 s").count()
        focused(page, "combobox", "Trial").press("ArrowDown")
        assert shown_methods(page) == ["dwa", "mine"]
        focused(page, "checkbox", "mine").press("Space")
        assert shown_methods(page) == ["dwa"]
        page.locator("body").press("Space")
        page.get_by_role("button", name="Pause").wait_for()
