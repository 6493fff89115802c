"""Tests of the dimensionless encoding.

Observations do not depend on the robot's size, mirrored scenes give mirrored observations, and
actions become valid parameters.
"""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.policy import methods
from applr_ros1.policy.actor import load as load_policy
from applr_ros1.policy.actor import save
from applr_ros1.policy.decision import Context
from applr_ros1.policy.dimensionless import SIZE, DimensionlessEncoding
from applr_ros1.policy.encoding import with_mirror_images
from applr_ros1.robots import JACKAL, NAMES, load
from applr_ros1.robots.learned import OUTPUTS, default_space
from applr_ros1.robots.robot import SpaceParameter, Target
from tests.policy import golden_encoding
from tests.support.refusals import refused

MIRROR = DimensionlessEncoding(JACKAL, 1.0).mirror
JACKAL_CHOSEN = [p.name for p in JACKAL.space if p.paper]
ROBOTS = [load(name) for name in NAMES]
WIDE = [
    replace(robot, space=default_space(robot.base, robot.body, robot.parameters()))
    for robot in ROBOTS
]


def context(robot, rng, side=1.0):
    """Return a random scene, or its mirror image if side is -1."""
    encoding = DimensionlessEncoding(robot, 1.0)
    ranges = rng.uniform(0.1, 6.0, encoding.layout.beams).astype(np.float32)[:: int(side)]
    yaw, turn, phi, x, y = rng.uniform(-1.0, 1.0, 5)
    plan = np.column_stack([np.linspace(x, x + 5.0, 60), np.linspace(y, 2.0, 60)]) * (1.0, side)
    goal = (plan[-1, 0], plan[-1, 1], 0.0)
    moving = (0.4 * robot.base.max_speed, side * turn)
    pose = (x, side * y, side * yaw)
    movers = rng.uniform(-4.0, 4.0, (rng.integers(1, 6), 4)) * (1.0, side, 1.0, side)
    return Context(
        ranges,
        side * phi,
        encoding.space.theta0,
        0.0,
        pose,
        moving,
        goal,
        plan,
        movers,
        encoding.space,
    )


def network(rng):
    sizes = (SIZE, 16, len(OUTPUTS))
    weights = {}
    for i, (width, out) in enumerate(zip(sizes, sizes[1:])):
        weights["%d.weight" % i] = rng.normal(0.0, 0.1, (out, width)).astype(np.float32)
        weights["%d.bias" % i] = np.zeros(out, np.float32)
    return weights


@pytest.mark.parametrize(
    "robot", ROBOTS + WIDE, ids=[*NAMES, *(name + " by default" for name in NAMES)]
)
def test_actions_encode_parameters_within_the_robots_ranges(robot):
    encoding = DimensionlessEncoding(robot, 1.0)
    rng = np.random.default_rng(0)
    for action in rng.uniform(-1.0, 1.0, (50, len(OUTPUTS))):
        theta = encoding.theta(action)
        assert np.array_equal(theta, encoding.space.clip(theta))
        if robot in WIDE:  # Default bounds contain the parameters of every action.
            inside = [
                i
                for i, name in enumerate(OUTPUTS)
                if "samples" not in name and "inflation" not in name
            ]
            back = encoding.action(theta)[inside]
            free = (theta > encoding.space.low + 1e-9) & (theta < encoding.space.high - 1e-9)
            kept = [
                free[encoding.space.names.index(n)] if n in encoding.space.names else False
                for n in OUTPUTS
            ]
            same = np.abs(back - action[inside]) < 1e-6
            assert (same | ~np.array(kept)[inside]).all()
    refused(lambda: encoding.theta(np.full(len(OUTPUTS), np.nan)), "finite")


@pytest.mark.parametrize("robot", ROBOTS, ids=NAMES)
def test_an_observation_is_mirrored_as_the_scene_is(robot):
    encoding = DimensionlessEncoding(robot, 1.0)
    image = DimensionlessEncoding(robot, 1.0)
    for seed in range(3):  # Later observations also contain changes since the previous one.
        seen = encoding.observe(context(robot, np.random.default_rng(seed)))
        mirrored = image.observe(context(robot, np.random.default_rng(seed), side=-1.0))
        assert seen.shape == (SIZE,)
        assert np.abs(seen).max() <= 1.0
        np.testing.assert_allclose(seen[MIRROR.order] * MIRROR.sign, mirrored, atol=2e-6)
    encoding.reset()
    first = encoding.observe(context(robot, np.random.default_rng(5)))
    # Without a previous decision the scan is repeated.
    np.testing.assert_array_equal(first[: SIZE // 4], np.roll(first, -240)[: SIZE // 4])


@pytest.mark.parametrize("name", NAMES)
def test_observations_parameters_and_rewards_equal_the_golden_file(name):
    with np.load(golden_encoding.FILE) as arrays:
        golden = {
            key.partition("/")[2]: array
            for key, array in arrays.items()
            if key.startswith(name + "/")
        }
    for key, output in golden_encoding.outputs(load(name), golden).items():
        np.testing.assert_array_equal(output, golden[key], key)


def test_the_nearest_moving_obstacles_are_in_the_robots_frame():
    """The robot faces +y. One obstacle approaches from ahead, one recedes on the left, others are
    farther away.
    """
    encoding = DimensionlessEncoding(JACKAL, 1.0)
    rng = np.random.default_rng(0)
    movers = np.array(
        [(9.0, 2.0, 0.3, 0.3), (-2.0, 2.0, -1.0, 0.0), (9.0, 9.0, 0, 0), (1.0, 4.0, 0.0, -0.5)]
    )
    here = replace(context(JACKAL, rng), pose=(1.0, 2.0, np.pi / 2), movers=movers)
    length = 15.0 * encoding.width
    fast = JACKAL.base.max_speed
    ahead = (2.0 / length, 0.0, -0.5 / fast, 0.0)
    left = (0.0, 3.0 / length, 0.0, 1.0 / fast)
    right = (0.0, -1.0, 0.3 / fast, -0.3 / fast)  # 8 m away, where positions are capped
    np.testing.assert_allclose(encoding.observe(here)[-12:], [*ahead, *left, *right], atol=1e-6)
    np.testing.assert_array_equal(
        encoding.observe(replace(here, movers=movers[:0]))[-12:], [1.0, 0.0, 0.0, 0.0] * 3
    )


def test_a_scene_of_twice_the_size_gives_the_same_observation():
    encoding = DimensionlessEncoding(JACKAL, 1.0)
    near = context(JACKAL, np.random.default_rng(0))
    small = encoding.observe(near)[:240]
    encoding.layout = encoding.layout.__class__(
        180,
        encoding.layout.angle_min,
        encoding.layout.angle_max,
        2 * encoding.layout.range_cap,
        1.0,
    )
    large = encoding._scan(2.0 * near.ranges)
    np.testing.assert_allclose(small, large, atol=1e-6)


def test_parameters_that_an_action_does_not_choose_have_the_policys_base(tmp_path):
    base = {
        "min_in_place_vel_theta": 0.9,
        "footprint_padding": 9.0,
        "max_vel_x": 0.3,
        "of_another_robot": 1.0,
    }
    weights = network(np.random.default_rng(0))
    path = tmp_path / "based.safetensors"
    save(path, weights, encoding=DimensionlessEncoding(JACKAL, 1.0, base))
    method = methods.make(str(path), JACKAL)
    method.reset(0)
    decided = method.space.as_dict(method.theta(context(JACKAL, np.random.default_rng(0))))
    assert (decided["min_in_place_vel_theta"], decided["footprint_padding"]) == (0.9, 0.14)
    assert decided["max_vel_x"] != 0.3


def test_a_parameter_with_a_range_out_of_reach_is_not_chosen():
    """min_vel_x is a backward speed for DWAPlannerROS, but the smallest forward speed for
    TrajectoryPlannerROS.
    """
    targets = (Target(server="TrajectoryPlannerROS", name="min_vel_x"),)
    ahead = SpaceParameter(name="min_vel_x", range=(0.02, 0.4), sets=targets)
    encoding = DimensionlessEncoding(replace(JACKAL, space=(*JACKAL.space, ahead)), 1.0)
    assert set(encoding.chosen) == {*JACKAL_CHOSEN, "sim_time"}
    assert encoding.theta(np.full(len(OUTPUTS), -1.0))[-1] == 0.1


def test_one_file_drives_every_robot(tmp_path):
    rng = np.random.default_rng(0)
    weights = network(rng)
    path = str(tmp_path / "general.safetensors")
    save(path, with_mirror_images(weights, MIRROR), encoding=DimensionlessEncoding(JACKAL, 1.0))
    assert len(load_policy(path).layers[0][0]) == 2
    size = (tmp_path / "general.safetensors").stat().st_size
    # Mirror images are not stored.
    assert size < 1.2 * sum(tensor.nbytes for tensor in weights.values())
    for robot in ROBOTS:
        method = methods.make(path, robot)
        method.reset(0)
        theta = method.theta(context(robot, rng))
        assert method.period == 1.0
        assert theta.shape == (len(method.space),)
        assert np.array_equal(theta, method.space.clip(theta))
