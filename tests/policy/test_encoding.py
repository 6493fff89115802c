"""Tests of the dimensionless encoding.

Observations do not depend on the robot's size, mirrored scenes give mirrored observations, and
actions become valid parameters.
"""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.policy import methods
from applr_ros1.policy.actor import save
from applr_ros1.policy.decision import Context
from applr_ros1.policy.dimensionless import SIZE, DimensionlessEncoding
from applr_ros1.policy.encoding import with_mirror_images
from applr_ros1.robots import JACKAL, NAMES, load
from applr_ros1.robots.learned import OUTPUTS, default_space
from tests.policy import golden_encoding
from tests.support.refusals import refused

PERIOD = 1.0  # time between two decisions [s]
MIRROR = DimensionlessEncoding(JACKAL, PERIOD).mirror
JACKAL_CHOSEN = [parameter.name for parameter in JACKAL.space if parameter.paper]
ROBOTS = [load(name) for name in NAMES]
# The same robots with the default space, which is wide
WIDE = []
for robot in ROBOTS:
    space = default_space(robot.base, robot.body, robot.parameters())
    WIDE.append(replace(robot, space=space))
SCAN = 240  # entries of an observation that are one scan; there are four at the front
MOVERS = 12  # entries of an observation at its end: x, y, vx, vy of three moving obstacles


def context(robot, rng, side=1.0):
    """Return a random scene, or its mirror image if side is -1."""
    encoding = DimensionlessEncoding(robot, PERIOD)
    ranges = rng.uniform(0.1, 6.0, encoding.layout.beams).astype(np.float32)
    if side < 0.0:
        ranges = ranges[::-1]
    # The mirror axis is the x axis: y, yaw, turn rate and angles change their signs.
    yaw, turn, phi, x, y = rng.uniform(-1.0, 1.0, 5)
    plan_x = np.linspace(x, x + 5.0, 60)
    plan_y = side * np.linspace(y, 2.0, 60)
    mover_count = rng.integers(1, 6)
    movers = rng.uniform(-4.0, 4.0, (mover_count, 4))
    movers *= (1.0, side, 1.0, side)  # x, y, vx, vy
    return Context(
        ranges=ranges,
        phi=side * phi,
        theta=encoding.space.theta0,
        time=0.0,
        pose=(x, side * y, side * yaw),
        twist=(0.4 * robot.base.max_speed, side * turn),
        goal=(plan_x[-1], plan_y[-1], 0.0),
        plan=np.column_stack([plan_x, plan_y]),
        movers=movers,
        space=encoding.space,
    )


def network(rng):
    """Return random weights of a small actor, by name."""
    sizes = (SIZE, 16, len(OUTPUTS))
    weights = {}
    for layer, (inputs, outputs) in enumerate(zip(sizes, sizes[1:])):
        weight = rng.normal(0.0, 0.1, (outputs, inputs))
        weights[f"{layer}.weight"] = weight.astype(np.float32)
        weights[f"{layer}.bias"] = np.zeros(outputs, np.float32)
    return weights


@pytest.mark.parametrize(
    "robot",
    ROBOTS + WIDE,
    ids=[*NAMES, *map("{} by default".format, NAMES)],
)
def test_actions_encode_parameters(robot):
    encoding = DimensionlessEncoding(robot, PERIOD)
    rng = np.random.default_rng(0)
    for action in rng.uniform(-1.0, 1.0, (50, len(OUTPUTS))):
        theta = encoding.space.clip(encoding.theta(action))
        # Default bounds contain the parameters of every action.
        if robot in WIDE:
            assert_comes_back(encoding, action, theta)
    without_numbers = np.full(len(OUTPUTS), np.nan)
    refused(lambda: encoding.theta(without_numbers), "finite")


def assert_comes_back(encoding, action, theta):
    """The action of the parameters is the one that chose them, where no bound or rounding did."""
    space = encoding.space
    is_free = (theta > space.low + 1e-9) & (theta < space.high - 1e-9)
    encoded_action = encoding.action(theta)
    for index, name in enumerate(OUTPUTS):
        # Counts of samples are rounded, and inflation_radius has another range than its output.
        if "samples" in name or "inflation" in name or name not in space.names:
            continue
        if is_free[space.names.index(name)]:
            assert encoded_action[index] == pytest.approx(action[index], abs=1e-6), name


@pytest.mark.parametrize("robot", ROBOTS, ids=NAMES)
def test_an_observation_is_mirrored_as_the_scene_is(robot):
    encoding = DimensionlessEncoding(robot, PERIOD)
    mirror_encoding = DimensionlessEncoding(robot, PERIOD)
    # Later observations also contain changes since the previous one.
    for seed in range(3):
        scene = context(robot, np.random.default_rng(seed))
        mirrored_scene = context(robot, np.random.default_rng(seed), side=-1.0)
        observation = encoding.observe(scene)
        mirrored = mirror_encoding.observe(mirrored_scene)
        assert np.abs(observation).max() <= 1.0
        np.testing.assert_allclose(
            observation[MIRROR.order] * MIRROR.sign,
            mirrored,
            atol=2e-6,
        )

    encoding.forget_decision()
    first_observation = encoding.observe(context(robot, np.random.default_rng(5)))
    # Without a previous decision the scan is repeated.
    np.testing.assert_array_equal(
        first_observation[: SIZE // 4],
        np.roll(first_observation, -SCAN)[: SIZE // 4],
    )


@pytest.mark.parametrize("name", NAMES)
def test_observations_parameters_and_rewards_equal_the_golden_file(name):
    golden = {}
    with np.load(golden_encoding.FILE) as arrays:
        for array_name, array in arrays.items():
            robot_name, _, key = array_name.partition("/")
            if robot_name == name:
                golden[key] = array
    for key, output in golden_encoding.outputs(load(name), golden).items():
        np.testing.assert_array_equal(output, golden[key], key)


def test_the_nearest_moving_obstacles_are_in_the_robots_frame():
    """The robot faces +y. One obstacle approaches from ahead, one recedes on the left, others are
    farther away.
    """
    encoding = DimensionlessEncoding(JACKAL, PERIOD)
    rng = np.random.default_rng(0)
    on_the_right = (9.0, 2.0, 0.3, 0.3)
    on_the_left = (-2.0, 2.0, -1.0, 0.0)
    farthest = (9.0, 9.0, 0.0, 0.0)
    approaching = (1.0, 4.0, 0.0, -0.5)
    movers = np.array([on_the_right, on_the_left, farthest, approaching])
    scene = replace(context(JACKAL, rng), pose=(1.0, 2.0, np.pi / 2), movers=movers)

    # Positions are in units of 15 widths, and velocities in units of the largest speed.
    length = 15.0 * encoding.width
    max_speed = JACKAL.base.max_speed
    mover_ahead = (2.0 / length, 0.0, -0.5 / max_speed, 0.0)
    mover_left = (0.0, 3.0 / length, 0.0, 1.0 / max_speed)
    # 8 m away, where positions are capped
    mover_right = (0.0, -1.0, 0.3 / max_speed, -0.3 / max_speed)
    observed = encoding.observe(scene)[-MOVERS:]
    np.testing.assert_allclose(
        observed,
        [*mover_ahead, *mover_left, *mover_right],
        atol=1e-6,
    )

    empty_scene = replace(scene, movers=np.empty((0, 4)))
    observed_alone = encoding.observe(empty_scene)[-MOVERS:]
    np.testing.assert_array_equal(observed_alone, [1.0, 0.0, 0.0, 0.0] * 3)


def test_a_scene_of_twice_the_size_gives_the_same_observation():
    encoding = DimensionlessEncoding(JACKAL, PERIOD)
    scene = context(JACKAL, np.random.default_rng(0))
    observation = encoding.observe(scene)[:SCAN]
    layout = encoding.layout
    encoding.layout = replace(
        layout,
        beams=180,
        range_cap=2 * layout.range_cap,
        lookahead=1.0,
    )
    of_larger_scene = encoding.observe(replace(scene, ranges=2.0 * scene.ranges))[:SCAN]
    np.testing.assert_allclose(observation, of_larger_scene, atol=1e-6)


def test_parameters_that_an_action_does_not_choose_have_the_policys_base(tmp_path):
    base = {
        "min_in_place_vel_theta": 0.9,
        "footprint_padding": 9.0,
        "max_vel_x": 0.3,
        "of_another_robot": 1.0,
    }
    weights = network(np.random.default_rng(0))
    path = tmp_path / "based.safetensors"
    save(path, weights, encoding=DimensionlessEncoding(JACKAL, PERIOD, base))
    method = methods.make(str(path), JACKAL)
    method.reset(0)
    theta = method.theta(context(JACKAL, np.random.default_rng(0)))
    decided = method.space.as_dict(theta)
    assert decided["min_in_place_vel_theta"] == 0.9
    assert decided["footprint_padding"] == 0.14, "the largest padding of the Jackal's space"
    # An action chooses max_vel_x itself.
    assert decided["max_vel_x"] != 0.3


def test_a_policy_of_another_version_of_the_observation_is_refused():
    metadata = DimensionlessEncoding(JACKAL, PERIOD).to_metadata()
    assert DimensionlessEncoding.of(metadata, JACKAL).period == PERIOD
    older = {**metadata, "observation": "dimensionless-1"}
    refused(
        lambda: DimensionlessEncoding.of(older, JACKAL),
        "its observation is dimensionless-1: dimensionless-2 is needed",
    )


def test_a_parameter_with_a_range_out_of_reach_is_not_chosen():
    """min_vel_x is a backward speed for DWAPlannerROS, but the smallest forward speed for
    TrajectoryPlannerROS.
    """
    encoding = DimensionlessEncoding(JACKAL, PERIOD)
    assert set(encoding.chosen) == {*JACKAL_CHOSEN, "sim_time"}
    # The lowest action leaves it at the value of the Jackal's file.
    theta = encoding.theta(np.full(len(OUTPUTS), -1.0))
    assert encoding.space.as_dict(theta)["min_vel_x"] == 0.1


def test_one_file_drives_every_robot(tmp_path):
    rng = np.random.default_rng(0)
    weights = network(rng)
    path = tmp_path / "general.safetensors"
    encoding = DimensionlessEncoding(JACKAL, PERIOD)
    save(str(path), with_mirror_images(weights, MIRROR), encoding=encoding)
    for robot in ROBOTS:
        method = methods.make(str(path), robot)
        method.reset(0)
        theta = method.theta(context(robot, rng))
        assert method.period == PERIOD
        assert theta.shape == (len(method.space),)
