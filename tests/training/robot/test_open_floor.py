"""Tests of open_floor.py: its courses, the reasons of failures, and the remedies."""

import shutil
from contextlib import contextmanager

import numpy as np
import pytest

from applr_ros1.planner.parameters.settings import Change
from applr_ros1.robots import JACKAL, load
from applr_ros1.robots.check import Remark
from applr_ros1.robots.folder import forget, read
from applr_ros1.robots.geometry import bounding_box
from training.attempts.candidates import Candidate, CandidateList
from training.robot import check as check_robot
from training.robot import open_floor
from training.robot.failure import STANDS, failure_of
from training.robot.open_floor import OpenFloor, courses

BURGER = load("turtlebot3_burger")
HUSKY = load("husky")
PLANNER = "dwa_local_planner_params_burger.yaml"


def test_the_door_is_wider_than_the_padded_footprint_by_30_cm():
    *_, door_course = courses(BURGER)
    # Boxes are (x, y, yaw, length along x, length along y).
    left_box, right_box = sorted(door_course.boxes, key=lambda box: box[0])
    left_end = left_box[0] + left_box[3] / 2
    right_begin = right_box[0] - right_box[3] / 2
    # Width of the footprint, its padding on both sides, and the margin
    assert right_begin - left_end == pytest.approx(0.21 + 0.02 + 0.3, abs=1e-6)
    assert door_course.name == "drive through a door of 0.53 m"


def test_the_box_lies_halfway_and_is_half_as_long_as_the_robot():
    _, _, box_course, _ = courses(JACKAL)
    ((x, y, yaw, length, width),) = box_course.boxes
    _, goal_y, _ = box_course.course.goal
    assert (x, y, yaw) == (0.0, goal_y / 2, 0.0)
    # Half of 0.42 m, and of the padding on both sides
    robot_length = (
        JACKAL.body.size[0] + 2 * JACKAL.all_parameters()["local_costmap"]["footprint_padding"]
    )
    assert length == width == pytest.approx(robot_length / 2, abs=0.02)


def test_goals_lie_within_a_global_costmap_that_rolls(tmp_path):
    folder = shutil.copytree(BURGER.folder, tmp_path / "burger")
    robot_yaml = folder / "robot.yaml"
    content = robot_yaml.read_text()
    old = "rolling_window: false, width: 20, height: 20"
    assert old in content
    # 45 % of a small window; in a large one the distance that all robots of this size have
    for height, expected in ((2, 0.9), (40, 5.0 * BURGER.world_scale)):
        new = f"rolling_window: true, width: 40, height: {height}"
        robot_yaml.write_text(content.replace(old, new))
        forget()  # Robots are cached by folder.
        robot = read(str(folder))
        farthest_y = max(world.course.goal[1] for world in courses(robot))
        assert farthest_y == pytest.approx(expected)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("file", "old", "new", "course", "why"),
    [
        # Too little acceleration leaves no velocity within reach that is allowed. The monitor's
        # margin does not fit through the door. A planner that fears obstacles stands before it.
        (
            PLANNER,
            "acc_lim_x: 2.5",
            "acc_lim_x: 0.1",
            0,
            "% of its cycles, mostly because of its velocity limits (min_vel_trans",
        ),
        ("robot.yaml", "margin: 0.02", "margin: 0.4", 3, "the collision monitor blocks"),
        (PLANNER, "occdist_scale: 0.02", "occdist_scale: 5.0", 3, "it turns or stands"),
    ],
)
def test_the_reason_of_a_failed_drive_is_reported(file, old, new, course, why, tmp_path):
    folder = shutil.copytree(BURGER.folder, tmp_path / "burger")
    edited_file = folder / file
    content = edited_file.read_text()
    assert old in content
    content = content.replace(old, new)
    content = content.replace("acc_lim_theta: 3.2", "acc_lim_theta: 0.5")
    edited_file.write_text(content)
    robot = read(str(folder))
    world = courses(robot)[course]
    assert why in failure_of(OpenFloor(robot).drive(world))


def test_slipping_wheels_are_reported():
    """With hardly any friction the wheels turn, and the robot moves a small part of their way."""
    straight, *_ = courses(BURGER)
    drive = OpenFloor(BURGER, friction=0.001).drive(straight)
    failure = failure_of(drive)
    assert failure.startswith("the odometry arrived, the robot did not: its wheels slipped by 2.")
    assert failure.endswith("over 2.1 m")


# -- each course notices a fault
CANNOT_TURN = {
    "recovery_behavior_enabled": False,  # A recovery would turn the robot.
    "DWAPlannerROS": {"acc_lim_theta": 0.0, "min_vel_theta": 0.0},
}


def drives(robot, worlds):
    """Return for each course whether the robot drives it."""
    floor = OpenFloor(robot)
    successes = []
    for world in worlds:
        failure = failure_of(floor.drive(world))
        successes.append(failure == "")
    return successes


@pytest.mark.heavy
def test_a_robot_without_faults_drives_all_courses():
    assert drives(BURGER, courses(BURGER)) == [True] * 4
    assert drives(JACKAL, courses(JACKAL)) == [True] * 4


def test_the_turn_on_the_spot_takes_the_time_of_a_turn():
    """Position and goal are the same, so that only the heading is still to be reached."""
    _, turn_course, *_ = courses(BURGER)
    drive = OpenFloor(BURGER).drive(turn_course)
    assert failure_of(drive) == ""
    assert drive.goals[-1].end > np.pi / BURGER.base.max_yaw_rate


def test_a_planner_that_cannot_turn_fails_the_turn_and_the_box():
    robot = BURGER.with_parameters(CANNOT_TURN, "burger that cannot turn")
    # Straight on and through the door it need not turn.
    _, turn_course, box_course, _ = courses(robot)
    assert drives(robot, [turn_course, box_course]) == [False, False]


def test_a_goal_that_is_never_called_reached_fails_the_drive_straight_on():
    """The robot arrives in every other respect: only the planner's report is missing."""
    no_tolerance = {"DWAPlannerROS": {"yaw_goal_tolerance": 0.0}}
    robot = BURGER.with_parameters(no_tolerance, "burger that never arrives")
    straight, *_ = courses(robot)
    assert failure_of(OpenFloor(robot).drive(straight)).startswith(STANDS)


def scaled_footprint(robot, factor):
    """Return the robot with the box around its parts as footprint, scaled and without padding."""
    body_box = np.array(bounding_box(robot))
    min_x, max_x, min_y, max_y = (factor * body_box).tolist()
    outline = {
        "footprint": [
            [min_x, min_y],
            [min_x, max_y],
            [max_x, max_y],
            [max_x, min_y],
        ],
        "footprint_padding": 0.0,
    }
    costmaps = {"local_costmap": outline, "global_costmap": outline}
    return robot.with_parameters(costmaps, f"{robot.name} with {factor} times its footprint")


# -- remedies
def propose(monkeypatch, candidates):
    """Let these candidates be all that could be set in any robot."""
    listed = CandidateList(candidates, [])
    monkeypatch.setattr(open_floor, "candidates_of", lambda robot: listed)


def leave_out(monkeypatch, count):
    """Leave out the first `count` courses of a check, whose outcome is not the one at stake."""
    monkeypatch.setattr(open_floor, "courses", lambda robot: courses(robot)[count:])


@pytest.mark.slow
def test_a_planner_that_only_stands_before_the_door_gets_a_remark_with_three_remedies(capsys):
    """By default, the Husky does not pass a door that is .3 m wider than its footprint."""
    # A remark leaves the check successful: an included robot must pass it.
    assert check_robot.main(["husky"]) == 0
    *_, door_line, remark = capsys.readouterr().out.splitlines()
    assert door_line.startswith("drive through a door of 0.98 m: it turns or stands")
    assert remark == (
        "remark: like the C++ planner, it does not drive through a door of 0.98 m: all four "
        "courses succeed if you set DWAPlannerROS/path_distance_bias to 32 instead of 0.6 and set "
        "DWAPlannerROS/goal_distance_bias to 20 instead of 0.8, or "
        "set DWAPlannerROS/occdist_scale to 0.005 instead of 0.01, or "
        "set DWAPlannerROS/goal_distance_bias to 1.6 instead of 0.8"
    )


def bias(value, name="goal_distance_bias", before=0.8):
    """Return a change of one of the Husky's weights."""
    return Change("DWAPlannerROS", name, before, value)


def test_the_mildest_remedy_is_first_and_no_parameter_is_named_twice(monkeypatch):
    """Of the usual values of the weight for the goal, two robots have 20, and none 9 or 2."""
    candidates = [
        Candidate((bias(9.0),)),
        Candidate((bias(20.0),)),
        Candidate((bias(0.5, "occdist_scale", 0.01),)),
        Candidate((bias(21.0), bias(30.0, "path_distance_bias", 0.6))),
        Candidate((bias(0.02, "occdist_scale", 0.01), bias(4.0))),
        Candidate((bias(2.0, "sim_time", 1.7),)),
    ]
    driven = []

    def fails(drive):
        """Return whether the drive of a robot fails, as all do with an occdist_scale alone."""
        return "stands" if drive.endswith("occdist_scale 0.01 -> 0.5") else ""

    class Floor:
        def __init__(self, robot):
            driven.append(robot.name)

        def drive(self, world):
            return driven[-1]

    propose(monkeypatch, candidates)
    monkeypatch.setattr(open_floor, "OpenFloor", Floor)
    monkeypatch.setattr(open_floor, "failure_of", fails)
    assert open_floor.remedy(HUSKY, [], []) == (
        "all four courses succeed if you "
        "set DWAPlannerROS/goal_distance_bias to 21 instead of 0.8 "
        "and set DWAPlannerROS/path_distance_bias to 30 instead of 0.6, or "
        "set DWAPlannerROS/occdist_scale to 0.02 instead of 0.01 "
        "and set DWAPlannerROS/goal_distance_bias to 4 instead of 0.8, or "
        "set DWAPlannerROS/goal_distance_bias to 9 instead of 0.8"
    )
    # The fourth remedy is not looked for.
    assert len(driven) == 4


@pytest.mark.heavy
def test_a_monitor_that_stops_it_before_the_door_is_an_error(tmp_path, monkeypatch):
    folder = shutil.copytree(BURGER.folder, tmp_path / "burger")
    robot_yaml = folder / "robot.yaml"
    content = robot_yaml.read_text()
    robot_yaml.write_text(content.replace("margin: 0.02", "margin: 0.2"))
    robot = read(str(folder))
    # Trying every parameter would take minutes, and finds none: the margin is none of the planner.
    propose(monkeypatch, [])
    leave_out(monkeypatch, 2)
    is_driving, (*_, door_line, error) = open_floor.try_out(robot)
    assert not is_driving
    assert "door of 0.53 m: the collision monitor blocks" in door_line
    assert error.startswith("error: it does not drive through a door of 0.53 m: ")
    assert "none of 0 changes that were tried helps" in error


@pytest.mark.heavy
def test_a_footprint_that_is_too_small_is_the_cause_and_no_parameter_is_proposed(monkeypatch):
    """The monitor stops the body, which the planner takes for smaller than it is.

    Only the box is at stake: with the default parameters, a Jackal may stand before a door of
    0.72 m, which fits its unpadded outline.
    """
    monkeypatch.setattr(
        open_floor, "candidates_of", lambda robot: pytest.fail("the cause is known")
    )
    monkeypatch.setattr(open_floor, "courses", lambda robot: courses(robot)[2:3])
    is_driving, (*_, error) = open_floor.try_out(scaled_footprint(JACKAL, 0.25))
    assert not is_driving
    cause = "error: it does not drive around a box: local_costmap/footprint is too small: "
    assert error.startswith(cause)
    assert error.endswith("; once this is corrected, all four courses succeed")
    assert "wrong" not in error


@pytest.mark.slow
def test_a_parameter_is_proposed_in_addition_to_a_known_fault_that_explains_only_a_part(
    monkeypatch,
):
    """By default, the Husky does not pass the door with the right footprint, either."""
    leave_out(monkeypatch, 3)
    is_driving, (*_, remark) = open_floor.try_out(scaled_footprint(HUSKY, 0.6))
    assert is_driving
    assert remark.startswith(
        "remark: it does not drive through a door of 0.71 m: local_costmap/footprint is too small"
    )
    assert "; once this is corrected, all four courses succeed if you set DWA" in remark
    assert "set DWAPlannerROS/occdist_scale to 0.005 instead of 0.01" in remark


@pytest.mark.heavy
def test_a_search_for_a_remedy_is_announced_with_the_course_that_failed(monkeypatch):
    works = []

    @contextmanager
    def announced(work, report, **times):
        works.append(work)
        yield

    monkeypatch.setattr(open_floor, "announced", announced)
    propose(monkeypatch, [])
    assert open_floor.try_out(BURGER)[0]
    assert works == ["driving on open floor (compiles kernels the first time, about a minute)"]

    leave_out(monkeypatch, 1)
    assert not open_floor.try_out(BURGER.with_parameters(CANNOT_TURN, "burger that turns not"))[0]
    assert works[2].startswith("searching for a remedy, because it does not turn on the spot (")


@pytest.mark.heavy
def test_a_correction_outside_the_parameter_space_is_no_attempt(monkeypatch):
    """The correction sets a speed above the range that parameter_space gives it."""
    too_fast = Remark("a fault", {"DWAPlannerROS": {"max_vel_x": 9.0}})
    monkeypatch.setattr(open_floor.check, "remarks", lambda robot: [too_fast])
    propose(monkeypatch, [])
    robot = BURGER.with_parameters(CANNOT_TURN, "burger with a fault")
    is_driving, (*_, error) = open_floor.try_out(robot)
    assert not is_driving
    assert error.endswith(open_floor.NO_REMEDY.format(count=0))
    assert "a fault" not in error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spoilt", "advice"),
    [
        ("occdist_scale", 20.0, "occdist_scale to 0.02 instead of 20"),
        ("forward_point_distance", 3.0, "forward_point_distance to 0.325 instead of 3"),
        ("acc_lim_theta", 0.1, "acc_lim_theta to 3.2 instead of 0.1"),
    ],
)
def test_the_remedy_names_the_value_that_was_changed(name, spoilt, advice):
    robot = BURGER.with_parameters({"DWAPlannerROS": {name: spoilt}}, f"burger of {name}")
    _, (*_, last_line) = open_floor.try_out(robot)
    assert ": all four courses succeed if you set " in last_line
    assert f"set DWAPlannerROS/{advice}" in last_line


@pytest.mark.heavy
def test_changes_that_do_not_help_are_counted_unless_no_drive_takes_place(monkeypatch):
    """One sample less does not help; a speed above its range and too many samples are no drives."""
    changes = [
        Change("DWAPlannerROS", "vx_samples", 20, 19),
        Change("DWAPlannerROS", "max_vel_x", 0.22, 9.0),
        Change("DWAPlannerROS", "vy_samples", 1, 1_000_000),
    ]
    candidates = [Candidate((change,)) for change in changes]
    propose(monkeypatch, candidates)
    leave_out(monkeypatch, 1)
    robot = BURGER.with_parameters(CANNOT_TURN, "burger that cannot turn at all")
    _, (*_, error) = open_floor.try_out(robot)
    assert "none of 1 changes that were tried helps" in error
