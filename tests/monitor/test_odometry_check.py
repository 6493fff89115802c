"""Tests of the comparison of an odometry's twists with its poses."""

import numpy as np
import pytest

from applr_ros1.monitor.odometry_check import OdometryCheck

STEP_S = 0.1
UNFILLED_TWIST = (
    "the odometry's velocity is 0 while its pose moves at 0.17 m/s: "
    "the planner takes the robot to stand; fill twist"
)
UNFILLED_POSE = (
    "the odometry's pose stays while its velocity is 0.17 m/s: "
    "the planner takes the robot to be where it was; fill pose"
)

UNFILLED_TURN_RATE = (
    "the odometry's turn rate is 0 while its pose turns at 0.50 rad/s: "
    "the planner takes the robot not to turn; fill twist"
)


def problem_of(poses, twists, step=STEP_S):
    """Return what is said after the last of some messages."""
    check = OdometryCheck()
    for row, (pose, twist) in enumerate(zip(poses, twists)):
        check.take(step * row, pose, twist)
    return check.problem


def line(speed, seconds=5.0, step=STEP_S):
    """Return the poses of a robot that drives straight on, sideways to the axes."""
    distances = speed * step * np.arange(round(seconds / step))
    return [(0.6 * distance, 0.8 * distance, np.arctan2(0.8, 0.6)) for distance in distances]


def turn(rate, seconds=5.0):
    """Return the poses of a robot that turns on the spot."""
    return [(0.0, 0.0, rate * STEP_S * row) for row in range(round(seconds / STEP_S))]


@pytest.mark.parametrize(
    ("poses", "twist", "problem"),
    [
        (line(0.17), (0.0, 0.0), UNFILLED_TWIST),
        # Backwards it is the same.
        (line(-0.17), (0.0, 0.0), UNFILLED_TWIST),
        (line(0.0), (0.17, 0.0), UNFILLED_POSE),
        (turn(0.5), (0.0, 0.0), UNFILLED_TURN_RATE),
    ],
)
def test_what_stays_0_while_the_other_moves_is_a_problem(poses, twist, problem):
    assert problem_of(poses, [twist] * len(poses)) == problem


@pytest.mark.parametrize("step", [0.02, 0.1, 0.5])
def test_poses_and_twists_that_agree_are_none_at_any_rate(step):
    poses = line(0.17, 5.0, step)
    assert problem_of(poses, [(0.17, 0.0)] * len(poses), step) == ""
    standing = [(1.0, 2.0, 0.5)] * len(poses)
    assert problem_of(standing, [(0.0, 0.0)] * len(poses), step) == ""


def test_messages_too_rare_for_a_velocity_are_not_judged():
    poses = line(0.17, 20.0, 2.0)
    assert problem_of(poses, [(0.17, 0.0)] * len(poses), 2.0) == ""
    assert problem_of(poses, [(0.0, 0.0)] * len(poses), 2.0) == ""


def test_a_jump_and_the_noise_of_a_standing_robot_are_none():
    jump = [(0.0, 0.0, 0.0)] * 25 + [(1.0, 0.5, 1.0)] * 25
    assert problem_of(jump, [(0.0, 0.0)] * 50) == ""
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, (0.01, 0.01, 0.02), (600, 3)).tolist()
    assert problem_of(noise, [(0.0, 0.0)] * 600) == ""


@pytest.mark.parametrize(
    ("pose_speed", "twist_speed"),
    [
        (0.02, 0.3),  # Its wheels slip.
        (0.3, 0.02),  # Its velocity has a wrong scale, but is filled.
        (0.02, 0.0),  # A scan matcher drifts.
    ],
)
def test_statements_that_differ_without_one_being_0_are_none(pose_speed, twist_speed):
    poses = line(pose_speed)
    assert problem_of(poses, [(twist_speed, 0.0)] * len(poses)) == ""


@pytest.mark.parametrize(
    ("poses_at", "twist_at", "smallest_motion"),
    [
        (line, lambda v: (v, 0.0), 0.05),
        (turn, lambda w: (0.0, w), 0.2),
    ],
    ids=["velocity", "turn rate"],
)
@pytest.mark.parametrize(
    ("share", "still", "is_problem"),
    [
        (1.02, 0.0, True),
        (0.98, 0.0, False),
        # A driver's 0 may be a rounding error.
        (2.0, 0.0009, True),
        (2.0, 0.0011, False),
    ],
)
def test_a_motion_above_its_limit_contradicts_what_is_0_to_a_thousandth(
    poses_at, twist_at, smallest_motion, share, still, is_problem
):
    moving = share * smallest_motion
    for pose_value, twist_value, remedy in (
        (moving, still, "; fill twist"),
        (still, moving, "; fill pose"),
    ):
        poses = poses_at(pose_value)
        problem = problem_of(poses, [twist_at(twist_value)] * len(poses))
        assert problem.endswith(remedy) == is_problem
        assert bool(problem) == is_problem


def test_a_contradiction_must_last_two_seconds_after_the_first_one():
    """It takes a second to measure the poses."""
    step = 1.0 / 64.0  # Its multiples are exact.
    check = OdometryCheck()
    problem_times = []
    for row, pose in enumerate(line(0.17, 4.0, step)):
        if check.take(step * row, pose, (0.0, 0.0)):
            problem_times.append(step * row)
    assert problem_times[0] == 3.0


def test_a_robot_that_starts_and_stops_is_none():
    # The pose shows a motion a little later than the twist.
    driven = np.concatenate([np.zeros(33), 0.05 * np.arange(1, 21), np.ones(30)])
    poses = [(x, 0.0, 0.0) for x in driven]
    twists = [(0.0, 0.0)] * 30 + [(0.5, 0.0)] * 23 + [(0.0, 0.0)] * 30
    check = OdometryCheck()
    for row, (pose, twist) in enumerate(zip(poses, twists)):
        assert check.take(STEP_S * row, pose, twist) == ""


def test_a_problem_stands_with_one_text_until_twist_and_poses_move_together():
    check = OdometryCheck()
    poses = line(0.17, 10.0)
    said = [check.take(STEP_S * row, pose, (0.0, 0.0)) for row, pose in enumerate(poses)]
    # It takes a second to measure the poses, and two to be sure.
    assert said[28] == ""
    assert set(said[31:]) == {UNFILLED_TWIST}
    assert check.lacks_twist

    # A robot that stands proves nothing.
    for row in range(100, 150):
        assert check.take(STEP_S * row, poses[-1], (0.0, 0.0)) == UNFILLED_TWIST
    for row in range(150, 160):
        x, y, yaw = poses[-1]
        moved = 0.1 * (row - 150)
        check.take(STEP_S * row, (x + 0.6 * moved, y + 0.8 * moved, yaw), (1.0, 0.0))
    assert check.problem == ""
    assert not check.lacks_twist
