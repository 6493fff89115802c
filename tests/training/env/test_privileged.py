"""Tests of the critics' privileged inputs: values by hand in a synthetic world, mirror images, and
layout.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sim_bridge
from applr_ros1.robots import JACKAL
from sim_bridge.passers_by import PassersBy
from training.env import privileged
from training.env.env import ApplrEnv
from training.env.privileged import ODD, SIZE, STATIONS, WIDTH
from worlds import Course, Mover, World

# Index of the first clearance, after the entries that change sign in a mirror image.
FIRST_CLEARANCE = len(ODD)
FIRST_MOVER = len(privileged.AHEAD)  # index of the lateral position of the nearest moving obstacle
OPTIONS = {
    "worlds": "generated:7",
    "period": 1.0,
    "observation": "dimensionless",
    "time_limit": 1.0,
}


def walker(x, y, speed_x=0.0, speed_y=0.0):
    """Return a mover that is at (x, y) [m] after five seconds, and walks at a speed [m/s]."""
    key_frames = []
    for time in map(float, range(11)):
        walked = time - 5.0
        key_frames.append((time, x + speed_x * walked, y + speed_y * walked))
    return Mover(0.25, tuple(key_frames))


def scene(side=1.0, movers=True):
    """Return a drive with the robot at the origin, a plan straight into a post, and a course
    around the post.
    """
    # World: post, course and a person who walks ahead and to one side, at 1 m/s along both axes
    post = np.array([[2.0 * WIDTH, side * 0.1 * WIDTH, 0.2 * WIDTH]])
    corners = np.array(
        [
            (0.0, 0.0),
            (1.0, side * 1.0),
            (3.0, side * 1.0),
            (5.0, 0.0),
        ]
    )
    course = Course(
        start=(0.0, 0.0, 0.0),
        goal=(8.0 * WIDTH, 0.0, 0.0),
        finish_y=None,
        goal_tolerance=0.4,
        path=WIDTH * corners,
    )
    person = walker(6.0, side * 7.0, speed_x=1.0, speed_y=side)
    world = World(
        "w",
        post,
        np.zeros((0, 5)),
        course,
        (person,) if movers else (),
    )

    # Planner: its plan leads ahead in the frame of a wrong odometry.
    believed_pose = (5.0, 3.0, side * 0.5 * math.pi)
    plan_x = np.full(90, 5.0)
    plan_y = 3.0 + side * np.linspace(0.0, 9.0 * WIDTH, 90)
    plan = np.column_stack([plan_x, plan_y])

    drawn = sim_bridge.simulator.Randomisation(
        latency=0.05,
        ground=0.25,
        friction=1.2,
        slip=0.7,
        odometry=2.0,
    )
    state = SimpleNamespace(
        pose=(0.0, 0.0, 0.0),
        odom_pose=believed_pose,
        time=5.0,
    )
    move_base = SimpleNamespace(global_plan=plan, variant="cpp-like")
    simulator = SimpleNamespace(drawn=drawn, passers_by=PassersBy(world, 0.3))
    simulated = SimpleNamespace(
        simulator=simulator,
        state=state,
        stack=SimpleNamespace(move_base=move_base),
        robot=JACKAL,
        place=believed_pose,
    )
    return SimpleNamespace(
        simulated=simulated,
        world=world,
        stall=SimpleNamespace(share=0.5),
    )


def share(value):
    """Return the share from 0 to 1 that an input from -1 to 1 stands for."""
    return (1.0 + value) / 2.0


def test_critics_observe_the_true_course_and_the_randomised_robot():
    observed = privileged.privileged(scene(), 1.0)
    assert observed.shape == (SIZE,)

    # The plan leads into the post, between 1.5 and 2 widths ahead.
    clearances = {}
    for station, clearance_input in zip(STATIONS, observed[FIRST_CLEARANCE:]):
        clearances[station] = privileged.CLEARANCE_CAP * share(clearance_input) ** 2
    assert clearances[2.0] == 0.0
    assert clearances[0.5] == pytest.approx(math.hypot(1.5, 0.1) - 0.2, abs=0.12)

    # It is free up to the post, and the length of the course is that round the post.
    after_clearances = observed[FIRST_CLEARANCE + 2 * len(STATIONS) :]
    free_input, length_input = after_clearances[:2]
    free_way = share(free_input) * STATIONS[-1]
    half_width = 0.5 * JACKAL.body.size[1] / WIDTH
    assert free_way == pytest.approx(2.0 - 0.2 - half_width, abs=0.25)
    course_length = math.sqrt(2.0) + 2.0 + math.sqrt(5.0) + 3.0
    assert share(length_input) * privileged.LONG == pytest.approx(course_length, abs=1e-4)

    # At 5 s the walker is far to the left.
    lateral_position, lateral_speed = observed[FIRST_MOVER : FIRST_MOVER + 2]
    assert lateral_position == 1.0
    assert lateral_speed == pytest.approx(1.0 / privileged.FAST, abs=1e-3)

    # Fidelity, ground, friction, slip, odometry, delay, laser noise, and the share of the stall
    drawn = after_clearances[-8:]
    np.testing.assert_allclose(drawn, [1.0, -0.5, 0.4, -0.3, 0.5, 0.0, 0.0, 0.0], atol=1e-6)


def test_critics_observe_course_and_nearest_movers_from_the_robot():
    # Given: a robot 0.8 widths beside the begin of its course, to the left of which it looks, with
    # a mover ahead, one to its left, and one far away
    drive = scene()
    side = 0.8 * WIDTH
    drive.simulated.state.pose = (0.0, -side, 0.5 * math.pi)
    far_away = walker(9.0, 0.0)
    to_the_left = walker(-2.0, -side)
    ahead = walker(0.0, 1.0 - side, speed_y=0.5)
    world = replace(drive.world, movers=(far_away, to_the_left, ahead))
    drive.simulated.simulator.passers_by = PassersBy(world, 0.3)

    observed = privileged.privileged(drive, 1.0)

    # The course after 2 widths, on its second leg, and after 5 widths, on its third leg
    x_2 = 1.0 + 2.0 - math.sqrt(2.0)
    along_third_leg = (5.0 - math.sqrt(2.0) - 2.0) / math.sqrt(5.0)
    x_5 = 3.0 + 2.0 * along_third_leg
    y_5 = 1.0 - along_third_leg
    after_clearances = observed[FIRST_CLEARANCE + 2 * len(STATIONS) :]
    distance_input, *cosines = after_clearances[2:5]
    assert share(distance_input) * privileged.FAR == pytest.approx(0.8, abs=1e-5)
    # In the robot's frame, the course's y is ahead, and its x to the right.
    expected_cosines = [1.8 / math.hypot(x_2, 1.8), (y_5 + 0.8) / math.hypot(x_5, y_5 + 0.8)]
    assert cosines == pytest.approx(expected_cosines, abs=1e-5)
    expected_sines = [-x_2 / math.hypot(x_2, 1.8), -x_5 / math.hypot(x_5, y_5 + 0.8)]
    assert observed[:FIRST_MOVER] == pytest.approx(expected_sines, abs=1e-5)

    # Position and speed of the nearest mover, then of the second one
    farthest = privileged.FAR * WIDTH
    lateral = observed[FIRST_MOVER:FIRST_CLEARANCE]
    forward = after_clearances[5:9]
    assert lateral == pytest.approx([0.0, 0.0, 2.0 / farthest, 0.0], abs=1e-5)
    walking = 0.5 / privileged.FAST
    assert forward == pytest.approx([1.0 / farthest, walking, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("movers", [True, False])
def test_a_mirrored_world_gives_the_mirrored_numbers(movers):
    to_the_left = privileged.privileged(scene(1.0, movers), 1.0)
    to_the_right = privileged.privileged(scene(-1.0, movers), 1.0)
    sign = np.ones(SIZE)
    sign[list(ODD)] = -1.0
    np.testing.assert_allclose(to_the_left * sign, to_the_right, atol=1e-6)
    assert np.abs(to_the_left[list(ODD)]).max() > 0.1


def test_privileged_numbers_follow_the_observation():
    layout = ApplrEnv(**OPTIONS, critics_know_more=True).layout
    without = ApplrEnv(**OPTIONS).layout
    assert layout.hidden == SIZE
    assert layout.seen == without.size
    assert layout.size == without.size + SIZE
    # The policy's part is mirrored as without them.
    assert np.array_equal(layout.policy_mirror.order, without.mirror.order)
    assert np.array_equal(layout.policy_mirror.sign, without.mirror.sign)
    hidden_signs = layout.mirror.sign[without.size :]
    assert np.flatnonzero(hidden_signs < 0).tolist() == list(ODD)


def test_courses_of_both_protocols_are_drawn_and_observed():
    env = ApplrEnv(**OPTIONS, critics_know_more=True, protocol="drawn")
    starts = set()
    for seed in range(8):
        observation, _ = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        hidden = privileged.privileged(env.course_drive, env.encoding.scale)
        assert np.array_equal(observation[-SIZE:], hidden)
        starts.add(env.course_drive.world.course.start)
    assert len(starts) == 2
    assert (-2.25, 3.0, math.pi / 2) in starts  # start of the BARN Challenge
