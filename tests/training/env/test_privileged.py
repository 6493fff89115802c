"""Tests of the critics' privileged inputs: values by hand in a synthetic world, mirror images, and
layout.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import sim_bridge
from applr_ros1.robots import JACKAL
from training.env import privileged
from training.env.env import ApplrEnv
from training.env.privileged import ODD, SIZE, STATIONS, WIDTH
from worlds import Course, Mover, World

# Index of the first clearance, after the entries that change sign in a mirror image.
PLACES = len(ODD)


def scene(side=1.0, movers=True):
    """Return an episode with the robot at the origin, a plan straight into a post, and a course
    around the post.
    """
    post = np.array([[2.0 * WIDTH, side * 0.1 * WIDTH, 0.2 * WIDTH]])
    path = WIDTH * np.array([(0.0, 0.0), (1.0, side * 1.0), (3.0, side * 1.0), (5.0, 0.0)])
    course = Course((0.0, 0.0, 0.0), (8.0 * WIDTH, 0.0, 0.0), None, 0.4, path)
    walker = Mover(0.25, tuple((t, 1.0 + t, side * (2.0 + t)) for t in map(float, range(11))))
    drawn = sim_bridge.simulator.Randomisation(
        latency=0.05, ground=0.25, friction=1.2, slip=0.7, odometry=2.0
    )
    # Wrong odometry, in whose frame the plan is given.
    believed = (5.0, 3.0, side * 0.5 * math.pi)
    plan = np.column_stack([np.full(90, 5.0), 3.0 + side * np.linspace(0.0, 9.0 * WIDTH, 90)])
    state = SimpleNamespace(pose=(0.0, 0.0, 0.0), odom_pose=believed, time=5.0)
    return SimpleNamespace(
        simulator=SimpleNamespace(state=state, drawn=drawn),
        world=World("w", post, np.zeros((0, 5)), course, (walker,) if movers else ()),
        move_base=SimpleNamespace(global_plan=plan, variant="cpp-like"),
        robot=JACKAL,
        place=believed,
        stall=SimpleNamespace(share=0.5),
    )


def test_critics_observe_the_true_course_and_the_randomised_robot():
    observed = privileged.privileged(scene(), 1.0)
    assert observed.shape == (SIZE,)
    clear = dict(zip(STATIONS, observed[PLACES:]))
    widths = {station: 2.0 * ((1.0 + value) / 2.0) ** 2 for station, value in clear.items()}
    # The plan leads into the post, between 1.5 and 2 widths ahead.
    assert widths[2.0] == 0.0
    assert widths[0.5] == pytest.approx(math.hypot(1.5, 0.1) - 0.2, abs=0.12)
    rest = observed[PLACES + 2 * len(STATIONS) :]
    free = (1.0 + rest[0]) / 2.0 * STATIONS[-1]
    assert free == pytest.approx(2.0 - 0.2 - 0.5 * JACKAL.body.size[1] / WIDTH, abs=0.25)
    left = math.sqrt(2.0) + 2.0 + math.sqrt(5.0) + 3.0
    assert (1.0 + rest[1]) / 2.0 * privileged.LONG == pytest.approx(left, abs=1e-4)
    assert rest[2] == -1.0  # The robot is on the course.
    # The course bends to the left.
    assert observed[0] == pytest.approx(math.sin(math.atan2(1.0, 1.6)), abs=0.06)
    # At 5 s the walker is far to the left.
    assert observed[len(privileged.AHEAD)] == 1.0
    assert observed[len(privileged.AHEAD) + 1] == pytest.approx(1.0 / privileged.FAST, abs=1e-3)
    np.testing.assert_allclose(rest[-8:], [1.0, -0.5, 0.4, -0.3, 0.5, 0.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("movers", [True, False])
def test_a_mirrored_world_gives_the_mirrored_numbers(movers):
    one = privileged.privileged(scene(1.0, movers), 1.0)
    other = privileged.privileged(scene(-1.0, movers), 1.0)
    sign = np.where(np.isin(np.arange(SIZE), ODD), -1.0, 1.0)
    np.testing.assert_allclose(one * sign, other, atol=1e-6)
    assert np.abs(one[list(ODD)]).max() > 0.1


def test_privileged_numbers_follow_the_observation_and_the_protocol_is_random():
    common = {
        "worlds": "generated:7",
        "period": 1.0,
        "observation": "dimensionless",
        "time_limit": 1.0,
    }
    env = ApplrEnv(**common, critics_know_more=True, protocol="drawn")
    layout = env.layout
    plain = ApplrEnv(**common).layout
    assert (layout.hidden, layout.seen, layout.size) == (SIZE, plain.size, plain.size + SIZE)
    assert np.array_equal(layout.policy_mirror.order, plain.mirror.order)
    assert np.array_equal(layout.policy_mirror.sign, plain.mirror.sign)
    assert np.flatnonzero(layout.mirror.sign[plain.size :] < 0).tolist() == list(ODD)
    courses = set()
    for seed in range(8):
        observation, _ = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        assert np.array_equal(
            observation[-SIZE:], privileged.privileged(env.episode, env.encoding.scale)
        )
        courses.add(env.episode.world.course.start)
    assert len(courses) == 2
    assert (-2.25, 3.0, math.pi / 2) in courses  # start of the BARN Challenge
