"""Tests of the page of a single drive: its verdict, its clock by keyboard, and another drive beside
it.
"""

from dataclasses import replace

import numpy as np
import pytest

import worlds
from applr_ros1.drives.drive import REACHED, TIMED_OUT, Goal
from applr_ros1.drives.page import PageScene, Shown, nearest_obstacle, page, verdict_of
from applr_ros1.policy.parameter_space import SPACE
from applr_ros1.robots import JACKAL, geometry
from tests.support.browser import focused, needs_browser, opened, shown_methods
from tests.support.drives import driven
from tests.support.pages import data_of

# Corners of a robot of 0.4 x 0.2 m [m]
OUTLINE = np.array([(0.2, 0.1), (-0.2, 0.1), (-0.2, -0.1), (0.2, -0.1)])
COURSE = worlds.Course(
    start=(0.0, 0.0, 0.0),
    goal=(3.0, 0.0, 0.0),
    finish_y=None,
    goal_tolerance=0.5,
    path=np.empty((0, 2)),
)
# A cylinder beside the path: its surface is 0.5 m from the path.
CYLINDER = np.array([[1.5, 0.6, 0.1]])
NO_BOXES = np.empty((0, 5))
WORLD = worlds.World("lane", CYLINDER, NO_BOXES, COURSE)


def straight(status=REACHED, speed=1.0):
    """Return a drive of three metres along the x axis, with two decisions."""
    times = np.arange(0.0, 3.0 / speed + 0.01, 0.05)
    zeros = np.zeros(len(times))
    drive = driven(
        times,
        pose=np.column_stack([speed * times, zeros, zeros]),
        twist=np.column_stack([zeros + speed, zeros]),
        theta=[SPACE.theta0, SPACE.high],
        decided=[0.0, 1.0],
    )
    end_time = float(times[-1])
    drive.goals = [Goal("goal", 0.0, end_time, status, "it went too slowly")]
    return drive


def written(path, drive, method="applr", outline=OUTLINE):
    """Write the page of a drive, and return its path."""
    shown_drive = Shown(0, 0, drive)
    scene = PageScene("lane", WORLD, [shown_drive])
    html = page("title", "verdict", [method], SPACE, outline, [scene])
    path.write_bytes(html)
    return path


def drive_on(page_data):
    """Return the only drive in a page's data."""
    (world,) = page_data["worlds"]
    (drive,) = world["drives"]
    return drive


def test_the_verdict_says_time_length_and_the_nearest_obstacle():
    # 0.5 m from the path, less half of the robot's width
    verdict = verdict_of(straight(), WORLD, OUTLINE)
    assert verdict == "Reached the goal in 3.0 s, 3.0 m, nearest obstacle 0.40 m"
    failed_drive = straight(TIMED_OUT)
    failed_drive.contacts = np.array([1.0])
    verdict = verdict_of(failed_drive, WORLD, OUTLINE)
    assert verdict.startswith("Did not reach the goal: it went too slowly after 3.0 s")
    assert verdict.endswith(", was touched at 1.0 m/s")


def test_the_outline_is_compared_with_obstacles_that_move():
    # The cylinder comes near the path at 2 s, when the robot is there.
    waypoints = ((0.0, 9.0, 9.0), (2.0, 2.0, 0.25), (4.0, 9.0, 9.0))
    moving_cylinder = worlds.Mover(0.1, waypoints)
    no_cylinders = np.empty((0, 3))
    world = worlds.World("lane", no_cylinders, NO_BOXES, COURSE, (moving_cylinder,))
    # Its surface is 0.15 m from the path, and the robot's side 0.1 m.
    assert nearest_obstacle(straight(), world, OUTLINE, 0.0) == pytest.approx(0.05, abs=0.01)
    # A second later, it is not there.
    assert nearest_obstacle(straight(), world, OUTLINE, 1.0) > 0.5


def test_a_round_robot_is_drawn_and_measured_as_round(tmp_path):
    round_body = JACKAL.body.model_copy(update={"round": True, "size": (0.6, 0.6, 0.2)})
    outline = geometry.outline(replace(JACKAL, body=round_body))
    html_path = written(tmp_path / "a.html", straight(), outline=outline)
    drawn_outline = np.array(data_of(html_path.read_text())["outline"])
    # The corner of a box would be 0.42 m from its centre.
    assert np.hypot(*drawn_outline.T) == pytest.approx(0.3, abs=0.015)
    assert drawn_outline == pytest.approx(outline, abs=1e-3)
    # The obstacle is at the side of the last pose, and 0.6 m away from the path.
    corner_obstacle = worlds.World("lane", np.array([[3.35, 0.35, 0.05]]), NO_BOXES, COURSE)
    distance = nearest_obstacle(straight(), corner_obstacle, outline, 0.0)
    assert distance == pytest.approx(np.hypot(0.35, 0.35) - 0.05 - 0.3, abs=0.01)


def test_parameters_have_their_values_in_their_own_units(tmp_path):
    page_data = data_of(written(tmp_path / "a.html", straight()).read_text())
    first_set, second_set = drive_on(page_data)["theta"]
    assert first_set == pytest.approx(SPACE.theta0, rel=1e-3)
    assert second_set == pytest.approx(SPACE.high, rel=1e-3)
    shown_names = [parameter["name"] for parameter in page_data["parameters"]]
    assert shown_names == list(SPACE.names)


@needs_browser
def test_keys_move_the_clock_and_what_shows_it(tmp_path):
    # It plays for six seconds, in which a busy browser, too, shows the button that ends it.
    with opened(written(tmp_path / "a.html", straight(speed=0.5))) as browser_page:
        # A page of one world lets nobody choose.
        assert not browser_page.get_by_role("combobox", name="World").count()
        # Charts are drawn in the first frame, after the page has been loaded.
        browser_page.get_by_text("max_vel_x: 0.5").wait_for()

        # The slider's keys
        time_slider = focused(browser_page, "slider", "Time in seconds")
        time_slider.press("End")
        assert browser_page.get_by_text("6.0 of 6.0 s").count()
        assert browser_page.get_by_text("max_vel_x: 2").count()
        time_slider.press("Home")
        time_slider.press("ArrowRight")
        assert browser_page.get_by_text("0.1 of 6.0 s").count()

        # The button plays to the end.
        focused(browser_page, "button", "Play").press("Enter")
        browser_page.get_by_role("button", name="Pause").wait_for()
        browser_page.get_by_text("6.0 of 6.0 s").wait_for()


def test_what_is_set_after_the_end_of_a_drive_is_left_out(tmp_path):
    drive = straight()
    first_decision = drive.decisions[0]
    late_decision = first_decision._replace(time=3.4)
    refused_decision = first_decision._replace(time=2.9, after={})
    drive.decisions += [late_decision, refused_decision]
    page_data = data_of(written(tmp_path / "a.html", drive).read_text())
    shown_drive = drive_on(page_data)
    # Times of the others [0.01 s]
    assert shown_drive["at"] == [0, 100]
    assert len(shown_drive["theta"]) == 2


@needs_browser
def test_another_drive_is_shown_beside_the_first_one(tmp_path):
    slow_page = written(tmp_path / "slow.html", straight(speed=0.5), method="dwa")
    with opened(written(tmp_path / "a.html", straight())) as browser_page:
        file_input = browser_page.locator("input[type=file]")
        file_input.set_input_files(slow_page)
        browser_page.get_by_role("checkbox", name="dwa").wait_for()
        # The clock goes on until the slower drive has ended.
        assert browser_page.get_by_text("0.0 of 6.0 s").count()
        assert shown_methods(browser_page) == ["applr", "dwa"]
        focused(browser_page, "checkbox", "applr").press("Space")
        assert shown_methods(browser_page) == ["dwa"]
