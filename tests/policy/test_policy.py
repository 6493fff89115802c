"""Tests of parameter space, observation and policy file: values, errors, agreement with scipy and
torch.
"""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given
from hypothesis import strategies as st

import applr_ros1
import worlds
from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import actor as actor_module
from applr_ros1.policy import methods
from applr_ros1.policy.actor import Policy, load, save
from applr_ros1.policy.decision import Context, Seen
from applr_ros1.policy.encoding import Mirror, with_mirror_images
from applr_ros1.policy.observation import (
    LAYOUT,
    ObservationError,
    beginning,
    goal_angle,
    local_goal,
    observe,
    smooth,
)
from applr_ros1.policy.parameter_space import SPACE, THETA_0, space_of
from tests.support.refusals import refused
from tests.support.robots import make_weights
from tests.support.seeds import examples
from training.env.settings import TrialSettings
from training.evaluate import runner
from training.evaluate.trial import plan_trials
from worlds import barn

PLANNER = "TrajectoryPlannerROS"
COSTMAPS = ("local_costmap", "global_costmap")
INFLATION = ("local_costmap/inflater_layer", "global_costmap/inflater_layer")
# Policy with random weights.
DRAWN = Policy.of(make_weights())
SHIPPED_DRIVES = ("generated:8", "generated:35", "generated:123")


def test_a_robot_without_parameters_for_policies_has_an_empty_space():
    space = space_of(replace(robots.JACKAL, space=()))
    assert len(space) == 0
    assert space.clip([]).shape == (0,)


def test_theta_0_is_clearpaths_and_survives_a_round_trip():
    of_paper = [0.5, 1.57, 6, 20, 0.1, 0.75, 1.0, 0.30]
    assert THETA_0.tolist() == [*of_paper, 2.0, 0.314, 0.1, 0.1, 0.1, 0.1]
    action = SPACE.to_action(THETA_0)
    np.testing.assert_allclose(SPACE.to_theta(action), THETA_0)
    with pytest.raises(ValueError, match="read-only"):
        THETA_0[0] = 1.0
    assert SPACE.as_dict(THETA_0)["vx_samples"] == 6
    assert isinstance(SPACE.as_dict(THETA_0)["vx_samples"], int)


def test_a_largest_speed_limits_the_smallest_speed_of_the_planner_too():
    slow_space = SPACE.below(0.3)
    fastest = slow_space.as_dict(slow_space.clip(SPACE.high))
    for name, value in SPACE.as_dict(SPACE.high).items():
        is_speed = name in ("max_vel_x", "min_vel_x")
        assert fastest[name] == (0.3 if is_speed else value), name


def test_actions_reach_the_ranges_and_never_leave_them_and_counts_are_rounded():
    for entry, reached in (
        (1.0, SPACE.high),
        (1e9, SPACE.high),
        (-1.0, SPACE.low),
        (-1e9, SPACE.low),
    ):
        action = np.full(len(SPACE), entry)
        np.testing.assert_allclose(SPACE.to_theta(action), reached)
    # The third parameter is vx_samples.
    assert SPACE.clip([*THETA_0[:2], 6.9, *THETA_0[3:]])[2] == 7
    assert SPACE.from_dict({"max_vel_x": 1.5})[0] == 1.5


@examples(200)
@given(
    st.lists(
        st.floats(allow_nan=True, allow_infinity=True),
        min_size=len(SPACE),
        max_size=len(SPACE),
    )
)
def test_any_action_gives_valid_parameters_or_is_rejected(values):
    if not np.all(np.isfinite(values)):
        refused(lambda: SPACE.to_theta(values), "not finite")
        return
    theta = SPACE.to_theta(values)
    assert np.all(theta >= SPACE.low)
    assert np.all(theta <= SPACE.high)
    # vx_samples and vtheta_samples
    assert theta[2] == round(theta[2])
    assert theta[3] == round(theta[3])


def test_the_sets_of_contexts_are_clipped_and_their_counts_rounded():
    weights = {
        "0.weight": np.zeros((1, 720), np.float32),
        "0.bias": np.zeros(1, np.float32),
    }
    # The speed is over its bound, and both counts lie between two numbers.
    offsets = np.array([9.0, 0.0, 0.4, 0.6, 0.0, 0.0, 0.0, 0.0])
    unclipped_theta = SPACE.chosen.theta0 + offsets
    policy = actor_module.ContextPolicy({"open": unclipped_theta}, weights, SPACE, LAYOUT)
    (theta,) = policy.sets
    assert theta[:4].tolist() == [2.0, 1.57, 6.0, 21.0]
    assert SPACE.to_theta(np.full(len(SPACE), 0.123))[2] == 13.0


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (
            lambda: SPACE.to_theta(np.zeros(7)),
            r"action vector has shape \(7,\): 14 values are needed",
        ),
        (
            lambda: SPACE.from_dict({"speed": 1.0}),
            "unknown parameter 'speed': use max_vel_x, ",
        ),
        (
            lambda: SPACE.from_dict({"max_vel_x": 3.0}),
            "max_vel_x is 3.0: give a number from 0.2 to 2",
        ),
        (
            lambda: SPACE.from_dict({"max_vel_x": "fast"}),
            "max_vel_x is 'fast': give a number",
        ),
        (
            lambda: DRAWN.encoding.theta(DRAWN.action(np.full(729, np.nan, np.float32))),
            "not finite",
        ),
        (
            lambda: methods.make("fast"),
            "method 'fast' is unknown: give dwa, ",
        ),
        (
            lambda: methods.make("/nowhere/actor.safetensors"),
            "/nowhere/actor.safetensors: cannot be read",
        ),
        (
            lambda: methods.make("static", robots.load("turtlebot3_burger")),
            "no .*static.json: choose the method dwa, or run `./applr tune .*`, and give",
        ),
        (
            lambda: local_goal(np.empty((0, 3)), (0.0, 0.0, 0.0)),
            "global plan is empty",
        ),
        (
            lambda: local_goal(np.full((5, 2), np.nan), (0.0, 0.0, 0.0)),
            "global plan or pose is not finite",
        ),
        (
            lambda: observe(np.full(720, np.nan), 0.0, THETA_0),
            "all 720 beams of the scan measure nothing",
        ),
        (
            lambda: observe(np.ones(719), 0.0, THETA_0),
            "scan has 719 beams: the policy takes 720",
        ),
        (
            lambda: observe(np.ones(720), np.nan, THETA_0),
            "angle of the local goal is nan",
        ),
    ],
)
def test_errors_are_one_line(call, line):
    # What comes from sensors is an error of the observation: the next one may be right.
    is_of_sensors = {"local_goal", "observe"} & set(call.__code__.co_names)
    refused(call, line, kind=ObservationError if is_of_sensors else ApplrError)


def test_ranges_lie_within_the_servers_bounds():
    for index, target in SPACE.addresses:
        declared = robots.JACKAL.servers[target.server].declared(target.name)
        # min_vel_theta is negated, so that its bounds change places.
        bounds = (target.signed(SPACE.low[index]), target.signed(SPACE.high[index]))
        assert declared.min <= min(bounds) < max(bounds) <= declared.max


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 18, 19, 20, 37, 200])
def test_smoothing_equals_scipy_and_keeps_short_plans(count):
    from scipy.signal import savgol_filter

    rng = np.random.default_rng(count)
    points = np.cumsum(rng.normal(size=(count, 2)), axis=0)
    if count < 5:
        np.testing.assert_array_equal(smooth(points), points)
        return
    # A filter's window has an odd number of points.
    window = min(19, count if count % 2 else count - 1)
    expected = savgol_filter(points, window, 3, axis=0)
    np.testing.assert_allclose(smooth(points), expected, atol=1e-9)


def test_local_goal_is_the_first_point_beyond_a_metre_in_the_robots_frame():
    # Straight line along +y.
    plan = np.zeros((200, 3))
    plan[:, 1] = np.arange(200) * 0.025

    # The robot faces along the plan.
    goal_x, goal_y = local_goal(plan, (0.0, 0.0, np.pi / 2))
    assert goal_x == pytest.approx(1.025)
    assert goal_y == pytest.approx(0.0, abs=1e-9)

    # The plan is on its left.
    goal_on_the_left = local_goal(plan, (0.0, 0.0, 0.0))
    assert goal_angle(goal_on_the_left) == pytest.approx(np.pi / 2)

    # A short plan gives its last point.
    _, last_y = local_goal(plan[:11], (0.0, 0.0, 0.0))
    assert last_y == pytest.approx(0.25)


@pytest.mark.parametrize("distance", [0.5, 1.0, 4.0])
def test_the_beginning_of_a_plan_has_the_local_goals_of_the_whole_plan(distance):
    """The filter that smooths a plan looks ahead of each point."""
    rng = np.random.default_rng(0)
    plan = np.cumsum(rng.normal((0.03, 0.0), 0.02, (400, 2)), axis=0)
    pose = (0.1, -0.05, 0.4)
    points = beginning(plan, pose, distance)
    assert len(points) < 200
    for lookahead in (0.2, 0.9 * distance, distance):
        whole_goal = local_goal(plan, pose, lookahead)
        assert local_goal(points, pose, lookahead) == pytest.approx(whole_goal, abs=1e-9)
    # A plan that ends before stays whole.
    np.testing.assert_array_equal(beginning(plan[:5], pose, distance), plan[:5])


def seen_with(plan, ranges=1.0):
    """Return the inputs of a robot at (1, 2), whose goal is ahead of it to the left."""
    return Seen(
        scan=(np.full(720, ranges, np.float32), LAYOUT.angle_min, LAYOUT.step),
        time=0.0,
        pose=(1.0, 2.0, 0.5),
        twist=(0.0, 0.0),
        goal=(3.0, 4.0, 0.0),
        plan=np.asarray(plan, dtype=float).reshape(-1, 2),
        movers=np.zeros((0, 4)),
    )


@pytest.mark.parametrize(
    ("lookahead", "bearing"),
    [
        (0.5, 0.0),
        (2.0, np.arccos(0.9 / 2.0)),
    ],
)
def test_the_local_goal_is_that_of_the_layout_and_without_a_plan_the_goal(lookahead, bearing):
    # The plan leads along x for 0.9 m, and then along y. The robot's yaw is 0.5 rad.
    distances = np.arange(0.0, 0.9, 0.02)
    along_x = np.column_stack([1.0 + distances, np.full(45, 2.0)])
    along_y = [(1.9, 2.0 + y) for y in np.arange(0.0, 3.0, 0.02)]
    layout = replace(LAYOUT, lookahead=lookahead)
    context = Context.of(THETA_0, seen_with([*along_x, *along_y]), SPACE, layout)
    assert context.phi == pytest.approx(bearing - 0.5, abs=0.02)

    # The first decision may come before the first plan. The goal is at 45 degrees.
    before_plan = Context.of(THETA_0, seen_with([]), SPACE, layout)
    assert before_plan.phi == pytest.approx(np.pi / 4 - 0.5)


def test_a_blind_scan_is_refused_whether_or_not_a_method_looks_at_it():
    blind = seen_with([], ranges=np.nan)
    refused(
        lambda: Context.of(THETA_0, blind, SPACE, LAYOUT), "measure nothing", kind=ObservationError
    )


def test_an_observation_has_its_layout_and_scale():
    ranges = np.full(720, 1.5, dtype=np.float32)
    ranges[:4] = np.inf, 30.0, -np.inf, 0.1
    observation = observe(ranges, np.pi / 2, THETA_0)
    assert observation.dtype == np.float32

    # Ranges from 0 to 2 m, the angle in units of pi, and the parameters as actions
    np.testing.assert_allclose(observation[:5], [1.0, 1.0, -1.0, -0.9, 0.5], atol=1e-6)
    assert observation[720] == pytest.approx(0.5)
    action = SPACE.to_action(THETA_0)[:8]
    np.testing.assert_allclose(observation[721:], action, atol=1e-6)

    # A person may have set a value out of the policy's range.
    out_of_range = [5.0, *THETA_0[1:]]
    assert observe(np.ones(720), 0.0, out_of_range)[721] == 1.0


def test_nan_beams_are_interpolated():
    ranges = np.linspace(0.2, 1.8, 720)
    with_holes = ranges.copy()
    with_holes[[0, 100, 101, 719]] = np.nan
    scan = observe(with_holes, 0.0, THETA_0)[:720]
    # Ranges from 0 to 2 m are entries from -1 to 1.
    np.testing.assert_allclose(scan, ranges - 1, atol=3e-3)


@examples(100)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(-10, 10))
def test_observation_is_always_finite_and_in_the_box(seed, share, phi):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(-5, 40, 720)
    is_invalid = rng.random(720) < share
    # A scan without any valid beam is refused.
    is_invalid[360] = False
    invalid_ranges = [np.nan, np.inf, -np.inf, 1e38, 0.0]
    ranges[is_invalid] = rng.choice(invalid_ranges, is_invalid.sum())
    theta = rng.normal(size=len(SPACE)) * 100
    observation = observe(ranges, phi, theta)
    assert np.all(np.isfinite(observation))
    assert np.all(np.abs(observation) <= 1.0)


def test_actor_round_trip_and_equality_with_torch(tmp_path):
    torch = pytest.importorskip("torch")
    # Given: a stored actor of the paper's size
    weights = make_weights(hidden=(512, 512, 512))
    save(tmp_path / "a.safetensors", weights, {"training": {"steps": 3}})
    actor = load(tmp_path / "a.safetensors")
    assert actor.metadata["training"] == {"steps": 3}
    rng = np.random.default_rng(1)
    observations = rng.uniform(-1, 1, (16, 729)).astype(np.float32)

    # Then: its actions are those of the same layers in torch
    activations = torch.from_numpy(observations)
    for layer in range(4):
        weight = torch.from_numpy(weights[f"{layer}.weight"])
        bias = torch.from_numpy(weights[f"{layer}.bias"])
        activations = activations @ weight.T + bias
        activations = torch.relu(activations) if layer < 3 else torch.tanh(activations)
    actions = actor.action(observations)
    np.testing.assert_allclose(actions, activations.numpy(), atol=1e-5)

    # One observation by itself; its action chooses the paper's eight parameters.
    action = actor.action(observations[0])
    np.testing.assert_allclose(action, actions[0], atol=1e-5)
    theta = actor.encoding.theta(action)
    whole_action = [*action, *[0] * (len(SPACE) - 8)]
    np.testing.assert_array_equal(theta[:8], SPACE.to_theta(whole_action)[:8])
    np.testing.assert_array_equal(theta[8:], THETA_0[8:])


class Bomb:
    """Object whose pickle leaves a mark when it is read."""

    def __reduce__(self):
        return (exec, ("import builtins; builtins.applr_bomb = True",))


def _raw(weights, **metadata):
    """Return a file of weights with any metadata, as bytes."""
    return safetensors.numpy.save(weights, metadata=metadata)


def _wrong_files():
    """Return {case: (bytes of a file, what its error says)}."""
    weights = make_weights()
    space = json.dumps(SPACE.chosen.to_dict())
    layout = json.dumps(LAYOUT.to_dict())
    header = dict(
        robot='"jackal"',
        format=actor_module.FORMAT,
        space=space,
        layout=layout,
    )
    whole_file = _raw(weights, **header)
    other_space = json.loads(space)
    other_space["high"][0] = 1.0
    other_header = dict(header, space=json.dumps(other_space))
    of_other_space = _raw(weights, **other_header)
    of_other_robot = _raw(weights, **dict(header, robot='"husky"'))
    of_other_format = _raw(weights, **dict(header, format="applr-actor-1"))
    in_double_precision = {name: tensor.astype(float) for name, tensor in weights.items()}
    # An observation of the 720 beams and the goal's angle, without the eight parameters
    of_other_shape = _raw(make_weights(inputs=721), **header)
    return {
        "truncated": (whole_file[: len(whole_file) // 2], "damaged or of another kind"),
        "pickle": (pickle.dumps(Bomb()), "damaged or of another kind"),
        "space": (of_other_space, "another parameter space: high"),
        "robot": (of_other_robot, "made for the robot husky: this robot is jackal"),
        "format": (of_other_format, "unknown policy format 'applr-actor-1'"),
        "numbers": (
            _raw(in_double_precision, **header),
            "its tensor .* is float64: float32 is needed",
        ),
        "shapes": (of_other_shape, "721, 8.* inputs and outputs: .*729, 8"),
    }


@pytest.mark.parametrize("case", sorted(_wrong_files()))
def test_invalid_policy_files_are_rejected_in_one_line(case, tmp_path):
    import builtins

    file_bytes, expected_error = _wrong_files()[case]
    policy_file = tmp_path / "actor.safetensors"
    policy_file.write_bytes(file_bytes)
    refused(lambda: load(policy_file), expected_error, str(policy_file))
    assert not hasattr(builtins, "applr_bomb")


def test_the_default_parameters_may_differ_from_those_of_a_policys_training(tmp_path):
    save(tmp_path / "a.safetensors", make_weights())
    slow = {PLANNER: {"max_vel_x": 0.4}}
    robot = robots.JACKAL.with_parameters(slow, "jackal")
    assert load(tmp_path / "a.safetensors", robot).space.theta0[0] == 0.4


def test_contexts_with_parameters_in_another_order_are_refused(tmp_path):
    reversed_space = space_of(replace(robots.JACKAL, space=robots.JACKAL.space[::-1]))
    policy_file = tmp_path / "contexts.safetensors"
    actor_module.save_contexts(
        policy_file,
        {"open": reversed_space.chosen.theta0},
        make_weights(inputs=720, outputs=1),
        space=reversed_space,
    )
    refused(lambda: load(policy_file), "its parameters are .*: max_vel_x, .* are needed")


def test_saving_is_atomic(tmp_path):
    for path in (tmp_path / "none.safetensors", tmp_path):
        refused(lambda path=path: load(path), str(path))
    refused(
        lambda: save(tmp_path / "a.safetensors", make_weights(outputs=7)),
        "its network has",
    )
    refused(
        lambda: save(tmp_path / "nowhere" / "a.safetensors", make_weights()),
        "cannot be written",
    )
    # No part of a file is left.
    assert list(tmp_path.iterdir()) == []


def test_one_request_for_each_server():
    theta = SPACE.from_dict(
        {
            "max_vel_theta": 2.0,
            "pdist_scale": 0.5,
            "vx_samples": 9,
            "inflation_radius": 0.4,
        }
    )
    requests = SPACE.settings(theta)
    assert list(requests) == [PLANNER, *INFLATION, *COSTMAPS]
    of_planner = requests[PLANNER]
    assert of_planner["min_vel_theta"] == -of_planner["max_vel_theta"] == -2.0
    assert of_planner["path_distance_bias"] == 0.5
    assert isinstance(of_planner["vx_samples"], int)
    for server in INFLATION:
        assert requests[server] == {"inflation_radius": 0.4}
    assert SPACE.read_back(requests).tolist() == theta.tolist()


@pytest.mark.parametrize("padding", [0.0, 0.05])
def test_a_set_lets_no_global_plan_through_a_gap_narrower_than_the_robot(padding):
    # The Jackal's footprint is 0.33 m wide, and a cell 0.05 m.
    needed_radius = 0.165 + padding + 0.025
    local_layer, global_layer = INFLATION

    def radii(radius):
        theta = SPACE.from_dict({"inflation_radius": radius, "footprint_padding": padding})
        settings = SPACE.settings(theta)
        return [settings[layer]["inflation_radius"] for layer in (local_layer, global_layer)]

    assert radii(0.1) == [0.1, pytest.approx(needed_radius)]
    assert radii(0.5) == [0.5, 0.5]


def test_named_methods_and_files_give_their_parameters(tmp_path):
    observation = observe(np.ones(720), 0.0, THETA_0)
    context = Context(np.ones(720, np.float32), 0.0, THETA_0, 0.0)
    # A method of the package
    dwa = methods.make("dwa")
    assert dwa.static
    assert dwa.theta(None).tolist() == THETA_0.tolist()

    # A policy file
    policy_file = tmp_path / "a.safetensors"
    save(policy_file, make_weights(), {"period_s": 1.0})
    applr = methods.make(str(policy_file))
    theta = Policy.of(make_weights()).theta(context)
    np.testing.assert_array_equal(applr.theta(context), theta)
    np.testing.assert_array_equal(context.observation, observation)
    assert applr.period == 1.0

    # A file of parameters, which has only some of them
    parameter_file = tmp_path / "set.json"
    parameter_file.write_text('{"max_vel_x": 1.5, "vx_samples": 12}')
    fixed = methods.make(str(parameter_file))
    assert fixed.theta(context)[:3].tolist() == [1.5, 1.57, 12]


def test_a_set_and_a_policy_say_up_to_which_range_obstacles_must_be_marked(tmp_path):
    # Given: a parameter set and a policy that were made for 5 m
    set_file = tmp_path / "set.json"
    set_file.write_text('{"obstacle_range": 5.0, "parameters": {"max_vel_x": 1.5}}')
    policy_file = tmp_path / "a.safetensors"
    save(policy_file, make_weights(), {"obstacle_range": 5.0})

    # Then: their methods say so, also to a node that imports no user's code
    for spec in (set_file, policy_file):
        assert methods.make(str(spec)).obstacle_range == 5.0
        assert methods.obstacle_range(str(spec), robots.JACKAL) == 5.0

    # The baseline drives with the files of the robot's maker, and so does what says nothing.
    save(policy_file, make_weights())
    for spec in ("dwa", "random", str(policy_file), "mine.py:Mine", "none.json"):
        assert methods.obstacle_range(spec, robots.JACKAL) is None


def test_random_parameters_are_drawn_evenly_from_the_whole_ranges():
    method = methods.make("random")
    actions = np.array([SPACE.to_action(method.theta(None)) for _ in range(400)])
    assert (actions.min(axis=0) < -0.9).all()
    assert (actions.max(axis=0) > 0.9).all()
    # The mean of 400 even draws from -1 to 1 has a standard deviation of 0.03.
    assert (np.abs(actions.mean(axis=0)) < 0.15).all()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        '{"speed": 1}',
        '{"max_vel_x": 9}',
        '{"obstacle_range": -1, "parameters": {}}',
        '{"obstacle_range": "far", "parameters": {}}',
    ],
)
def test_errors_of_parameter_files_are_one_line(text, tmp_path):
    parameter_file = tmp_path / "set.json"
    parameter_file.write_text(text)
    refused(lambda: methods.make(str(parameter_file)), str(parameter_file))


def test_mirror_images_are_stored_once(tmp_path):
    # Given: two networks and their mirror images, whose mean is the same in a mirrored scene
    first_network = make_weights(1)
    second_network = make_weights(2)
    pairs = {}
    for tensor_name, tensor in first_network.items():
        pairs[tensor_name] = np.stack([tensor, second_network[tensor_name]])
    weights = with_mirror_images(pairs, Mirror.of(720, 9))
    rng = np.random.default_rng(0)
    observation = rng.uniform(-1, 1, 729).astype(np.float32)
    # Mirrored are the beams, of which there are 720, and the goal's angle.
    scan = observation[719::-1]
    goal_angle = -observation[720:721]
    mirrored = np.concatenate([scan, goal_angle, observation[721:]])
    policy = Policy.of(weights)
    action = policy.action(observation)
    assert action == pytest.approx(policy.action(mirrored), abs=1e-6)

    # When: they are stored, and again after one of the four has changed
    save(tmp_path / "a", weights)
    change = np.float32([[0], [1e-3], [0], [0]])
    weights["2.bias"] = weights["2.bias"] + change
    save(tmp_path / "b", weights)

    # Then: the first file has half the networks, and each drives as what was stored
    assert (tmp_path / "a").stat().st_size < 0.6 * (tmp_path / "b").stat().st_size
    assert np.array_equal(load(tmp_path / "a").action(observation), action)
    changed_action = Policy.of(weights).action(observation)
    assert np.array_equal(load(tmp_path / "b").action(observation), changed_action)


@pytest.mark.heavy
def test_the_shipped_policy_has_metadata_and_beats_the_defaults():
    """method:=applr uses the Jackal's file, and drives three test worlds faster than theta_0."""
    method = methods.make("applr")
    assert method.period == 1.0
    assert method.path == methods.shipped(methods.POLICY, robots.load("jackal"))

    # It was trained in other worlds than those that it is tested in.
    training = method.metadata["training"]
    assert training["transitions"] > 10_000
    training_worlds = set()
    for spec in training["options"]["worlds"].split(","):
        training_worlds.update(worlds.specs(spec))
    assert len(training_worlds) > 200
    for number in barn.TEST:
        assert f"generated:{number}" not in training_worlds

    # A quarter less time than with theta_0
    driver = runner.TrialRunner(TrialSettings())
    seconds = {"dwa": 0.0, "applr": 0.0}
    tested_worlds = list(zip(SHIPPED_DRIVES, SHIPPED_DRIVES))
    compared_methods = [("dwa", "dwa"), ("applr", "applr")]
    for task in plan_trials(tested_worlds, compared_methods, 1, seed=0):
        result = driver.run(task)
        assert result.success, result
        seconds[task.method] += result.time_s
    assert seconds["applr"] < 0.75 * seconds["dwa"]


@pytest.mark.parametrize("name", ["jackal", "turtlebot3_waffle_pi"])
def test_a_loaded_policy_predicts_its_methods_decision(name):
    gymnasium = pytest.importorskip("gymnasium")
    from training.env import ID

    policy_file = methods.shipped(methods.POLICY, robots.JACKAL)
    policy = applr_ros1.load_policy(name, policy_file)
    environment = gymnasium.make(ID, worlds="generated:7", **policy.environment)
    observation, _ = environment.reset(seed=1)
    # Its arguments are those of stable-baselines3.
    action, state = policy.predict(
        observation,
        state=("kept",),
        episode_start=np.ones(1, bool),
        deterministic=False,
    )
    assert environment.action_space.contains(action)
    assert state == ("kept",)
    # Sums in single precision depend on the number of rows.
    actions, _ = policy.predict(np.stack([-observation, observation]))
    np.testing.assert_allclose(actions[1], action, atol=1e-5)

    method = methods.make(policy_file, robots.load(name))
    method.reset(0)
    unwrapped = environment.unwrapped
    course_drive = unwrapped.course_drive
    context = Context.of(course_drive.theta, course_drive.seen, method.space, method.layout)
    theta = method.theta(context)
    np.testing.assert_allclose(unwrapped.encoding.theta(action), theta, rtol=1e-6)
    assert unwrapped.course_drive.period == method.period
