"""Tests of the page of ./applr tune: its sentence, its courses, and its use without a mouse."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from applr_ros1.robots import JACKAL
from tests.support.browser import needs_browser, opened
from tests.support.pages import data_of
from tests.support.runs import SETTINGS
from training.evaluate.table import TrialTable
from training.evaluate.trial import Result, plan_trials
from training.tune.found_set import NEXT, Judgement
from training.tune.page import write

RULE = "a failure or contact costs 10 times the course's shortest time"
WORLDS = ["generated:1", "generated:2", "generated:3"]
TIMES = {"dwa": (20.0, None, None), "static": (12.0, 14.0, None)}  # None: a failure
# As found_set writes changes.csv: one parameter whose effect is unclear, and one that saves time.
CHANGED = pd.DataFrame(
    {
        "parameter": ["sim_time", "max_vel_x"],
        "default": ["2 s", "0.5 m/s"],
        "tuned": ["1.1 s", "1.4 m/s"],
        "without it [s]": [0.4, 9.5],
        "95 % low": [-1.0, 4.0],
        "95 % high": [2.0, 30.0],
        "median [s]": [0.1, 8.0],
        "effect": ["unclear", "saves"],
        "meaning": ["Duration of a sample.", "Largest velocity."],
    }
)


@pytest.fixture
def drives(tmp_path):
    """Return the folder of a set that was judged on three courses, with the monitor and without
    it.
    """
    (tmp_path / "tuned.yaml").write_text("DWAPlannerROS: {}\n")
    for monitor in ("with", "without"):
        plan = plan_trials(list(zip(WORLDS, WORLDS)), list(zip(TIMES, TIMES)), 1, seed=0)
        settings = dict(SETTINGS, worlds=WORLDS, world_specs=WORLDS)
        with TrialTable(tmp_path / monitor, settings) as store:
            for trial in plan:
                seconds = TIMES[trial.method][WORLDS.index(trial.world)]
                result = Result(
                    False,
                    time_s=100.0,
                    decisions=3,
                    path_length_m=6.0,
                    reason="no way. Even after recovery",
                    route_m=7.0,
                )
                if seconds is not None:
                    result = replace(
                        result,
                        success=True,
                        time_s=seconds,
                        reason="finished",
                    )
                store.add(trial, result)
    return tmp_path


def page_of(drives, *are_better):
    """Write the page, with a judgement on each file, and return its path."""
    files = ("tuned.yaml", "static.json")
    judgements = []
    for file_name, monitor, is_better in zip(files, ("without", "with"), are_better):
        judgement = Judgement(
            file_name,
            monitor,
            ["table", "line"],
            is_better,
            drives / file_name,
        )
        judgements.append(judgement)
    scope = "searched on 9 courses\nfor a building: MAP"
    return write(JACKAL, drives, CHANGED, judgements, scope, RULE)


@pytest.mark.parametrize(
    ("are_better", "file_name"),
    [((False, True), "static.json"), ((False, False), "tuned.yaml")],
)
def test_the_line_on_top_is_that_of_a_file_that_was_written(are_better, file_name, drives):
    page_text = page_of(drives, *are_better).read_text()
    assert f'<p class="verdict">{file_name}: line</p>' in page_text


def test_each_course_has_both_drives_and_an_effect_of_one_course_no_interval(drives):
    of_one_course = CHANGED.assign(**{"95 % low": float("nan"), "95 % high": float("nan")})
    judgement = Judgement("tuned.yaml", "without", ["table", "line"], True, drives / "tuned.yaml")
    page = write(JACKAL, drives, of_one_course, [judgement], "searched", RULE)
    page_data = data_of(page.read_text())
    first_change, second_change = page_data["changes"]
    assert first_change["95 % low"] is None
    assert second_change["95 % low"] is None

    (verdict,) = page_data["verdicts"]
    successes = [(course["before"]["ok"], course["after"]["ok"]) for course in verdict["courses"]]
    assert successes == [(True, True), (False, True), (False, False)]
    assert verdict["courses"][2]["after"]["why"] == "no way. Even after recovery"


@needs_browser
def test_the_page_shows_changes_and_failures_and_opens_its_details_by_keyboard(drives):
    with opened(page_of(drives, True, False)) as page:
        assert f'<rosparam file="{drives}/tuned.yaml"' in page.inner_text("body")
        assert "./applr demo" not in page.inner_text("body"), "static.json was not written"
        assert page.get_by_text(RULE).count() == 1
        changes = page.locator(".changes b").all_inner_texts()
        assert changes == ["max_vel_x", "sim_time"], "what saves something comes first"
        assert page.get_by_text("fails → fails: no way", exact=True).count() == 2
        assert not page.get_by_text("Largest velocity.").is_visible()
        summary = page.locator("summary", has_text="What the parameters mean")
        summary.focus()
        summary.press("Enter")
        assert page.get_by_text("Largest velocity.").is_visible()


@needs_browser
def test_a_set_that_was_not_written_is_not_to_be_loaded(drives):
    with opened(page_of(drives, False, False)) as page:
        page_text = page.inner_text("body")
    assert "How to load it" not in page_text
    assert "<rosparam" not in page_text
    assert "./applr demo" not in page_text
    assert NEXT in page_text


def test_the_paths_of_the_page_are_valid_in_any_folder(drives, monkeypatch):
    monkeypatch.chdir(drives.parent)
    page_data = data_of(page_of(Path(drives.name), True, True).read_text())
    paths = [verdict["path"] for verdict in page_data["verdicts"]]
    assert paths == [f"{drives}/tuned.yaml", f"{drives}/static.json"]
