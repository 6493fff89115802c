"""Tests of the page of a single drive: its verdict, its clock by keyboard, and another drive beside
it.
"""

import json
import re

import numpy as np
import pytest

import worlds
from applr_ros1.drives.drive import REACHED, TIMED_OUT, Goal
from applr_ros1.drives.page import Scene, Shown, nearest_obstacle, page, verdict_of
from applr_ros1.policy.parameter_space import SPACE
from tests.support.browser import focused, needs_browser, opened, shown_methods
from tests.support.drives import driven

BODY = (0.4, 0.2)  # length and width [m]
COURSE = worlds.Course((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), None, 0.5, np.empty((0, 2)))
# A cylinder beside the path: its surface is 0.5 m from the path.
WORLD = worlds.World("lane", np.array([[1.5, 0.6, 0.1]]), np.empty((0, 5)), COURSE)


def straight(status=REACHED, speed=1.0):
    """Return a drive of three metres along the x axis, with two decisions."""
    time = np.arange(0.0, 3.0 / speed + 0.01, 0.05)
    pose = np.column_stack([speed * time, 0.0 * time, 0.0 * time])
    twist = np.column_stack([np.full(len(time), speed), 0.0 * time])
    drive = driven(time, pose, twist, [SPACE.theta0, SPACE.high], [0.0, 1.0])
    drive.goals = [Goal("goal", 0.0, float(time[-1]), status, "timed out")]
    return drive


def written(path, drive, method="applr"):
    """Write the page of a drive, and return its path."""
    scene = Scene("lane", WORLD, [Shown(0, 0, drive)])
    path.write_bytes(page("title", "verdict", [method], SPACE, BODY, [scene]))
    return path


def drives_on(path):
    """Return the drives in a page's data, and the data."""
    data = json.loads(re.search(r'id="data">(.*?)</script>', path.read_text()).group(1))
    return data["worlds"][0]["drives"], data


def test_the_verdict_says_time_length_and_the_nearest_obstacle():
    # 0.5 m from the path, less half of the robot's width
    verdict = verdict_of(straight(), WORLD, BODY)
    assert verdict == "Reached the goal in 3.0 s, 3.0 m, nearest obstacle 0.40 m"
    failed = straight(TIMED_OUT)
    failed.contacts = np.array([1.0])
    verdict = verdict_of(failed, WORLD, BODY)
    assert verdict.startswith("Did not reach the goal: timed out after 3.0 s")
    assert verdict.endswith("touched something")


def test_the_outline_is_compared_with_obstacles_that_move():
    # The cylinder comes near the path at 2 s, when the robot is there; a second later, it is not.
    mover = worlds.Mover(0.1, ((0.0, 9.0, 9.0), (2.0, 2.0, 0.25), (4.0, 9.0, 9.0)))
    world = worlds.World("lane", np.empty((0, 3)), np.empty((0, 5)), COURSE, (mover,))
    assert nearest_obstacle(straight(), world, BODY, 0.0) == pytest.approx(0.05, abs=0.01)
    assert nearest_obstacle(straight(), world, BODY, 1.0) > 0.5


def test_parameters_have_their_values_in_their_own_units(tmp_path):
    (drive,), data = drives_on(written(tmp_path / "a.html", straight()))
    first_set, second_set = drive["theta"]
    assert first_set == pytest.approx(SPACE.theta0, rel=1e-3)
    assert second_set == pytest.approx(SPACE.high, rel=1e-3)
    assert [parameter["name"] for parameter in data["parameters"]] == list(SPACE.names)


@needs_browser
def test_keys_move_the_clock_and_what_shows_it(tmp_path):
    with opened(written(tmp_path / "a.html", straight())) as view:
        assert not view.get_by_role("combobox", name="World").count()
        assert view.get_by_text("max_vel_x: 0.5").count()
        slider = focused(view, "slider", "Time in seconds")
        slider.press("End")
        assert view.get_by_text("3.0 of 3.0 s").count()
        assert view.get_by_text("max_vel_x: 2").count()
        slider.press("Home")
        slider.press("ArrowRight")
        assert view.get_by_text("0.1 of 3.0 s").count()
        focused(view, "button", "Play").press("Enter")
        view.get_by_role("button", name="Pause").wait_for()
        view.get_by_text("3.0 of 3.0 s").wait_for()


def test_what_is_set_after_the_end_of_a_drive_is_left_out(tmp_path):
    drive = straight()
    drive.decisions.append(drive.decisions[0]._replace(time=3.4))
    drive.decisions.append(drive.decisions[0]._replace(time=2.9, after={}))
    (shown,), _ = drives_on(written(tmp_path / "a.html", drive))
    assert shown["at"] == [0, 100]
    assert len(shown["theta"]) == 2


@needs_browser
def test_another_drive_is_shown_beside_the_first_one(tmp_path):
    other = written(tmp_path / "slow.html", straight(speed=0.5), "dwa")
    with opened(written(tmp_path / "a.html", straight())) as view:
        chooser = view.locator("input[type=file]")
        chooser.set_input_files(other)
        view.get_by_role("checkbox", name="dwa").wait_for()
        assert view.get_by_text("0.0 of 6.0 s").count()
        assert shown_methods(view) == ["applr", "dwa"]
        focused(view, "checkbox", "applr").press("Space")
        assert shown_methods(view) == ["dwa"]
