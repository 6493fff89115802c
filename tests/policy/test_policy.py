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
from applr_ros1.policy.decision import Context
from applr_ros1.policy.encoding import Mirror, with_mirror_images
from applr_ros1.policy.observation import (
    LAYOUT,
    ObservationError,
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
    assert THETA_0.tolist() == [0.5, 1.57, 6, 20, 0.1, 0.75, 1.0, 0.30, 2.0, 0.314, 0.1, 0.1, 0.1]
    np.testing.assert_allclose(SPACE.to_theta(SPACE.to_action(THETA_0)), THETA_0)
    with pytest.raises(ValueError, match="read-only"):
        THETA_0[0] = 1.0
    assert SPACE.as_dict(THETA_0)["vx_samples"] == 6
    assert isinstance(SPACE.as_dict(THETA_0)["vx_samples"], int)


def test_actions_reach_the_ranges_and_never_leave_them_and_counts_are_rounded():
    for entry, reached in (
        (1.0, SPACE.high),
        (1e9, SPACE.high),
        (-1.0, SPACE.low),
        (-1e9, SPACE.low),
    ):
        np.testing.assert_allclose(SPACE.to_theta(np.full(len(SPACE), entry)), reached)
    assert SPACE.clip([*THETA_0[:2], 6.9, *THETA_0[3:]])[2] == 7
    assert SPACE.from_dict({"max_vel_x": 1.5})[0] == 1.5


@examples(200)
@given(
    st.lists(
        st.floats(allow_nan=True, allow_infinity=True), min_size=len(SPACE), max_size=len(SPACE)
    )
)
def test_any_action_gives_valid_parameters_or_is_rejected(values):
    if not np.all(np.isfinite(values)):
        refused(lambda: SPACE.to_theta(values), "not finite")
        return
    theta = SPACE.to_theta(values)
    assert np.all(theta >= SPACE.low)
    assert np.all(theta <= SPACE.high)
    assert theta[2] == round(theta[2])
    assert theta[3] == round(theta[3])


def test_the_sets_of_contexts_are_clipped_and_their_counts_rounded():
    weights = {"0.weight": np.zeros((1, 720), np.float32), "0.bias": np.zeros(1, np.float32)}
    wanted = SPACE.chosen.theta0 + np.array([9.0, 0.0, 0.4, 0.6, 0.0, 0.0, 0.0, 0.0])
    (theta,) = actor_module.ContextPolicy({"open": wanted}, weights, SPACE, LAYOUT).sets
    assert theta[:4].tolist() == [2.0, 1.57, 6.0, 21.0]
    assert SPACE.to_theta(np.full(len(SPACE), 0.123))[2] == 13.0


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (
            lambda: SPACE.to_theta(np.zeros(7)),
            r"action vector has shape \(7,\): 13 values are needed",
        ),
        (lambda: SPACE.from_dict({"speed": 1.0}), "unknown parameter 'speed': use max_vel_x, "),
        (
            lambda: SPACE.from_dict({"max_vel_x": 3.0}),
            "max_vel_x is 3.0: give a number from 0.2 to 2",
        ),
        (lambda: SPACE.from_dict({"max_vel_x": "fast"}), "max_vel_x is 'fast': give a number"),
        (
            lambda: DRAWN.encoding.theta(DRAWN.action(np.full(729, np.nan, np.float32))),
            "not finite",
        ),
        (lambda: methods.make("fast"), "method 'fast' is unknown: give dwa, "),
        (
            lambda: methods.make("/nowhere/actor.safetensors"),
            "/nowhere/actor.safetensors: cannot be read",
        ),
        (
            lambda: methods.make("static", robots.load("turtlebot3_burger")),
            "no .*static.json: run `./applr tune",
        ),
        (lambda: local_goal(np.empty((0, 3)), (0.0, 0.0, 0.0)), "global plan is empty"),
        (
            lambda: local_goal(np.full((5, 2), np.nan), (0.0, 0.0, 0.0)),
            "global plan or pose is not finite",
        ),
        (
            lambda: observe(np.full(720, np.nan), 0.0, THETA_0),
            "all 720 beams of the scan are NaN or 0",
        ),
        (lambda: observe(np.ones(719), 0.0, THETA_0), "scan has 719 beams: the policy takes 720"),
        (lambda: observe(np.ones(720), np.nan, THETA_0), "angle of the local goal is nan"),
    ],
)
def test_errors_are_one_line(call, line):
    # What comes from sensors is an error of the observation: the next one may be right.
    is_of_sensors = {"local_goal", "observe"} & set(call.__code__.co_names)
    refused(call, line, kind=ObservationError if is_of_sensors else ApplrError)


def test_ranges_lie_within_the_servers_bounds():
    for index, target in SPACE.addresses:
        declared = robots.JACKAL.servers[target.server].declared(target.name)
        low, high = sorted(map(target.signed, (SPACE.low[index], SPACE.high[index])))
        assert declared.min <= low < high <= declared.max


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 18, 19, 20, 37, 200])
def test_smoothing_equals_scipy_and_keeps_short_plans(count):
    from scipy.signal import savgol_filter

    points = np.cumsum(np.random.default_rng(count).normal(size=(count, 2)), axis=0)
    if count < 5:
        np.testing.assert_array_equal(smooth(points), points)
        return
    # A filter's window has an odd number of points.
    window = min(19, count if count % 2 else count - 1)
    expected = savgol_filter(points, window, 3, axis=0)
    np.testing.assert_allclose(smooth(points), expected, atol=1e-9)


def test_local_goal_is_the_first_point_beyond_a_metre_in_the_robots_frame():
    # Straight line along +y.
    plan = np.column_stack([np.zeros(200), np.arange(200) * 0.025, np.zeros(200)])
    goal_x, goal_y = local_goal(plan, (0.0, 0.0, np.pi / 2))
    assert goal_x == pytest.approx(1.025)
    assert goal_y == pytest.approx(0.0, abs=1e-9)
    assert goal_angle(local_goal(plan, (0.0, 0.0, 0.0))) == pytest.approx(np.pi / 2)
    # Last point of a short plan.
    assert local_goal(plan[:11], (0.0, 0.0, 0.0))[1] == pytest.approx(0.25)


def test_an_observation_has_its_layout_and_scale():
    ranges = np.full(720, 1.5, dtype=np.float32)
    ranges[:4] = np.inf, 30.0, -np.inf, 0.1
    observation = observe(ranges, np.pi / 2, THETA_0)
    assert observation.shape == (729,)
    assert observation.dtype == np.float32

    # Ranges from 0 to 2 m, the angle in units of pi, and the parameters as actions
    np.testing.assert_allclose(observation[:5], [1.0, 1.0, -1.0, -0.9, 0.5], atol=1e-6)
    assert observation[720] == pytest.approx(0.5)
    np.testing.assert_allclose(observation[721:], SPACE.to_action(THETA_0)[:8], atol=1e-6)

    # A person may have set a value out of the policy's range.
    beyond = [5.0, *THETA_0[1:]]
    assert observe(np.ones(720), 0.0, beyond)[721] == 1.0


def test_nan_beams_are_interpolated():
    ranges = np.linspace(0.2, 1.8, 720)
    with_holes = ranges.copy()
    with_holes[[0, 100, 101, 719]] = np.nan
    np.testing.assert_allclose(observe(with_holes, 0.0, THETA_0)[:720], ranges - 1, atol=3e-3)


@examples(100)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(-10, 10))
def test_observation_is_always_finite_and_in_the_box(seed, share, phi):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(-5, 40, 720)
    is_invalid = rng.random(720) < share
    # A scan without any valid beam is refused.
    is_invalid[360] = False
    ranges[is_invalid] = rng.choice([np.nan, np.inf, -np.inf, 1e38, 0.0], is_invalid.sum())
    observation = observe(ranges, phi, rng.normal(size=len(SPACE)) * 100)
    assert np.all(np.isfinite(observation))
    assert np.all(np.abs(observation) <= 1.0)


def test_actor_round_trip_and_equality_with_torch(tmp_path):
    torch = pytest.importorskip("torch")
    weights = make_weights(hidden=(512, 512, 512))
    save(tmp_path / "a.safetensors", weights, {"training": {"steps": 3}})
    actor = load(tmp_path / "a.safetensors")
    assert actor.metadata["training"] == {"steps": 3}
    observations = np.random.default_rng(1).uniform(-1, 1, (16, 729)).astype(np.float32)
    values = torch.from_numpy(observations)
    for index in range(4):
        weight = torch.from_numpy(weights[f"{index}.weight"])
        bias = torch.from_numpy(weights[f"{index}.bias"])
        values = values @ weight.T + bias
        values = torch.relu(values) if index < 3 else torch.tanh(values)
    np.testing.assert_allclose(actor.action(observations), values.numpy(), atol=1e-5)

    # One observation by itself; its action chooses the paper's eight parameters.
    action = actor.action(observations[0])
    np.testing.assert_allclose(action, actor.action(observations)[0], atol=1e-5)
    theta = actor.encoding.theta(action)
    filled = [*action, *[0] * (len(SPACE) - 8)]
    np.testing.assert_array_equal(theta[:8], SPACE.to_theta(filled)[:8])
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
    good = make_weights()
    space = json.dumps(SPACE.chosen.to_dict())
    layout = json.dumps(LAYOUT.to_dict())
    header = dict(robot='"jackal"', format=actor_module.FORMAT, space=space, layout=layout)
    whole = _raw(good, **header)
    other_space = json.loads(space)
    other_space["high"][0] = 1.0
    of_other_space = _raw(good, **dict(header, space=json.dumps(other_space)))
    of_other_shape = _raw(make_weights(inputs=721), **header)
    return {
        "truncated": (whole[: len(whole) // 2], "cut short"),
        "pickle": (pickle.dumps(Bomb()), "no safetensors file"),
        "space": (of_other_space, "another parameter space: high"),
        "shapes": (of_other_shape, "721, 8.* inputs and outputs: .*729, 8"),
    }


@pytest.mark.parametrize("case", sorted(_wrong_files()))
def test_invalid_policy_files_are_rejected_in_one_line(case, tmp_path):
    import builtins

    data, expected = _wrong_files()[case]
    path = tmp_path / "actor.safetensors"
    path.write_bytes(data)
    refused(lambda: load(path), expected, str(path))
    assert not hasattr(builtins, "applr_bomb")


def test_saving_is_atomic(tmp_path):
    for path in (tmp_path / "none.safetensors", tmp_path):
        refused(lambda path=path: load(path), str(path))
    refused(lambda: save(tmp_path / "a.safetensors", make_weights(outputs=7)), "its network has")
    refused(
        lambda: save(tmp_path / "nowhere" / "a.safetensors", make_weights()), "cannot be written"
    )
    assert list(tmp_path.iterdir()) == []


def test_one_request_for_each_server():
    theta = SPACE.from_dict(
        {"max_vel_theta": 2.0, "pdist_scale": 0.5, "vx_samples": 9, "inflation_radius": 0.4}
    )
    requests = SPACE.settings(theta)
    assert list(requests) == [PLANNER, *INFLATION, *COSTMAPS]
    assert requests[PLANNER]["min_vel_theta"] == -requests[PLANNER]["max_vel_theta"] == -2.0
    assert requests[PLANNER]["path_distance_bias"] == 0.5
    assert isinstance(requests[PLANNER]["vx_samples"], int)
    assert requests[INFLATION[0]] == requests[INFLATION[1]] == {"inflation_radius": 0.4}
    assert SPACE.read_back(requests).tolist() == theta.tolist()


def test_named_methods_and_files_give_their_parameters(tmp_path):
    observation = observe(np.ones(720), 0.0, THETA_0)
    context = Context(np.ones(720, np.float32), 0.0, THETA_0, 0.0)
    assert methods.make("dwa").static
    assert methods.make("dwa").theta(None).tolist() == THETA_0.tolist()
    save(tmp_path / "a.safetensors", make_weights(), {"period_s": 1.0})
    applr = methods.make(str(tmp_path / "a.safetensors"))
    np.testing.assert_array_equal(applr.theta(context), Policy.of(make_weights()).theta(context))
    np.testing.assert_array_equal(context.observation, observation)
    assert applr.period == 1.0
    (tmp_path / "set.json").write_text('{"max_vel_x": 1.5, "vx_samples": 12}')
    fixed = methods.make(str(tmp_path / "set.json"))
    assert fixed.theta(context)[:3].tolist() == [1.5, 1.57, 12]


@pytest.mark.parametrize("text", ["", "{", '{"speed": 1}', '{"max_vel_x": 9}'])
def test_errors_of_parameter_files_are_one_line(text, tmp_path):
    path = tmp_path / "set.json"
    path.write_text(text)
    refused(lambda: methods.make(str(path)), str(path))


def test_mirror_images_are_stored_once(tmp_path):
    # Given: two networks and their mirror images, whose mean is the same in a mirrored scene
    first = make_weights(1)
    second = make_weights(2)
    pairs = {name: np.stack([first[name], second[name]]) for name in first}
    weights = with_mirror_images(pairs, Mirror.of(720, 9))
    observation = np.random.default_rng(0).uniform(-1, 1, 729).astype(np.float32)
    # Mirrored are the beams, of which there are 720, and the goal's angle.
    scan = observation[719::-1]
    goal_angle = -observation[720:721]
    mirrored = np.concatenate([scan, goal_angle, observation[721:]])
    action = Policy.of(weights).action(observation)
    assert action == pytest.approx(Policy.of(weights).action(mirrored), abs=1e-6)

    # When: they are stored, and again after one of the four has changed
    save(tmp_path / "a", weights)
    weights["2.bias"] = weights["2.bias"] + np.float32([[0], [1e-3], [0], [0]])
    save(tmp_path / "b", weights)

    # Then: the first file has half the networks, and each drives as what was stored
    assert (tmp_path / "a").stat().st_size < 0.6 * (tmp_path / "b").stat().st_size
    assert np.array_equal(load(tmp_path / "a").action(observation), action)
    changed_action = Policy.of(weights).action(observation)
    assert np.array_equal(load(tmp_path / "b").action(observation), changed_action)


def test_the_shipped_policy_has_metadata_and_beats_the_defaults():
    """method:=applr uses the Jackal's file, and drives three test worlds faster than theta_0."""
    method = methods.make("applr")
    assert method.period == 1.0
    assert method.path == methods.shipped(methods.POLICY, robots.load("jackal"))

    # It was trained in other worlds than those that it is tested in.
    training = method.metadata["training"]
    assert training["transitions"] > 10_000
    trained_in = set()
    for part in training["options"]["worlds"].split(","):
        trained_in.update(worlds.specs(part))
    assert len(trained_in) > 200
    for number in barn.TEST:
        assert f"generated:{number}" not in trained_in

    # A quarter less time than with theta_0
    driver = runner.TrialRunner(TrialSettings())
    seconds = {"dwa": 0.0, "applr": 0.0}
    tested_worlds = list(zip(SHIPPED_DRIVES, SHIPPED_DRIVES))
    for task in plan_trials(tested_worlds, [("dwa", "dwa"), ("applr", "applr")], 1, seed=0):
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
    action, state = policy.predict(
        observation, state=("kept",), episode_start=np.ones(1, bool), deterministic=False
    )
    assert environment.action_space.contains(action)
    assert state == ("kept",)
    # Sums in single precision depend on the number of rows.
    np.testing.assert_allclose(
        policy.predict(np.stack([-observation, observation]))[0][1], action, atol=1e-5
    )
    method = methods.make(policy_file, robots.load(name))
    method.reset(0)
    decided = method.theta(environment.unwrapped.episode.context())
    np.testing.assert_allclose(environment.unwrapped.encoding.theta(action), decided, rtol=1e-6)
    assert environment.unwrapped.episode.period == method.period
