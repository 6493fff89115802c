"""Tests of the page of drives: it draws the driven paths, needs no other file, and escapes all
names.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from applr_ros1.policy.parameter_space import SPACE
from tests.support.browser import focused, needs_browser, opened
from tests.support.drives import driven
from tests.support.runs import SETTINGS
from training.evaluate import drives_page
from training.evaluate.report import write
from training.evaluate.table import Trials
from training.evaluate.trial import Result, plan_trials

TIME = 0.05 * np.arange(1, 123)
# [m, m, rad]
POSE = np.column_stack([-2.25 + np.sin(TIME), 4.0 + TIME, 3.0 + 0.1 * TIME])
TRACE = driven(
    TIME,
    POSE,
    np.column_stack([0.3 + 0.01 * TIME, 0.0 * TIME]),
    [SPACE.theta0, SPACE.high],
    [0.0, 1.0],
)
METHODS = ("dwa", "mine", "quiet")


@pytest.fixture
def folder(tmp_path):
    """Return the folder of an evaluation of three methods in a built-in world. The last method has
    no traces.
    """
    plan = plan_trials(
        [("generated:7", "generated:7")], [(m, m) for m in METHODS], 2, seed=0, traces=2
    )
    older = {name: value for name, value in SETTINGS["robot"].items() if name != "radius"}
    settings = dict(SETTINGS, worlds=["generated:7"], world_specs=["generated:7"], robot=older)
    store = Trials(tmp_path, settings)
    for task in plan:
        good = task.method == "dwa"
        result = Result(
            good, not good, False, 6.1, 3, 6.0, "finished" if good else "</script>", 7.0
        )
        store.add(task, result, TRACE.pack() if task.method != "quiet" else b"")
    return tmp_path


def test_the_page_has_the_driven_paths(folder):
    index = write(folder)
    text = (folder / "report" / drives_page.FILE).read_text(encoding="utf-8")
    assert 'href="drives.html"' in Path(index).read_text()
    assert not re.search(r'src=|@import|url\(|href="https?:', text)
    assert 'href="index.html"' in text  # link back to the report
    page = json.loads(
        re.search(
            r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL
        ).group(1)
    )
    assert [m["name"] for m in page["methods"]] == list(METHODS)
    (world,) = page["worlds"]
    assert world["name"] == "generated:7"
    assert [(d["m"], d["k"]) for d in world["drives"]] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    ends = [(d["ok"], d["hit"], d["why"]) for d in world["drives"][1:3]]
    assert ends == [(True, False, "finished"), (False, True, "</script>")]
    drive = world["drives"][0]
    poses = np.cumsum(drive["p"], axis=0) / 100.0
    rows = [*range(0, 121, 4), 121]
    np.testing.assert_allclose(poses, POSE[rows], atol=0.0051)
    np.testing.assert_allclose(drive["v"], 100 * TRACE.truth.twist[rows, 0], atol=0.6)
    assert drive["at"] == [0, 100]
    assert drive["theta"][1] == SPACE.high.tolist()
    left, bottom, right, top = np.array(world["view"]) / 100.0
    assert left < poses[:, 0].min() < poses[:, 0].max() < right
    assert bottom < poses[:, 1].min() < poses[:, 1].max() < top
    circles = np.array(world["circles"]) / 1000.0
    assert len(circles) > 50
    assert circles[:, 2] == pytest.approx(0.075, abs=0.001)
    assert world["finish"] == 1000


def test_without_traces_there_is_no_page(folder):
    for path in (folder / "traces").iterdir():
        path.unlink()
    assert "drives.html" not in Path(write(folder)).read_text()
    assert not (folder / "report" / drives_page.FILE).exists()


@needs_browser
def test_keys_choose_a_trial_play_and_hide_a_method(folder):
    write(folder)
    with opened(folder / "report" / drives_page.FILE) as view:
        assert view.get_by_text("0.0 of 6.2 s").count()
        focused(view, "combobox", "Trial").press("ArrowDown")
        rows = view.get_by_role("row")
        assert [row.inner_text().split()[0] for row in rows.all()[1:]] == ["dwa", "mine"]
        focused(view, "checkbox", "mine").press("Space")
        assert [row.inner_text().split()[0] for row in rows.all()[1:]] == ["dwa"]
        view.locator("body").press("Space")
        view.get_by_role("button", name="Pause").wait_for()
