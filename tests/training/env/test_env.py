"""Tests of reward and environment: the paper's MDP, Gymnasium's check, same seeds."""

import math
from dataclasses import replace
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.drives.outcome import Outcome
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.robots import JACKAL
from training.env.reward import Reward

PERIOD = 2.0  # time between two decisions [s]


# -- reward: the paper's section III-C -------------------------------------------------------------
STEP = Outcome(
    np.zeros(8),
    progress=0.9,
    progress_y=0.8,
    last_scan_min=0.4,
    decision_min=0.2,
    contact=True,
    seconds=2.0,
    decisions=3,
)
TERMS = ("time", "progress", "clearance", "collision")


def terms_of(reward, outcome, scale=1.0, pace=1.0, limit=50):
    """Return the terms of a reward by name, for a robot of some size and pace."""
    robot = SimpleNamespace(scale=scale, pace=pace)
    total, terms = reward(outcome, limit, PERIOD, robot)
    assert total == pytest.approx(sum(terms.values()))
    assert set(terms) == set(TERMS)
    return terms


def approx_terms(time, progress, clearance, collision):
    """Return terms for a comparison."""
    return pytest.approx(dict(zip(TERMS, (time, progress, clearance, collision))))


def test_the_reward_has_the_papers_terms():
    terms = terms_of(Reward(c_f=1.0, c_p=2.0, c_c=0.1), STEP)
    assert terms == approx_terms(time=-1.0, progress=1.8, clearance=-0.25, collision=0.0)

    everything = Reward(
        along_y=True,
        exact_time=True,
        lowest=True,
        c_collision=3.0,
    )
    terms = terms_of(everything, replace(STEP, seconds=0.5, success=True))
    assert terms == approx_terms(time=-0.25, progress=0.8, clearance=-0.25, collision=-3.0)

    at_the_goal = replace(STEP, success=True)
    assert terms_of(Reward(), at_the_goal)["time"] == 0.0, "R_f is 0 at the goal"
    with pytest.raises(ValueError, match="should be a finite number"):
        Reward(c_p=float("nan"))


# A laser whose range_min is 0 may report 0.
@pytest.mark.parametrize(("lowest", "clearance"), [(math.inf, -0.5), (0.1, -10.0), (0.0, -10.0)])
def test_distance_is_bounded_both_ways(lowest, clearance):
    outcome = replace(STEP, last_scan_min=lowest)
    assert terms_of(Reward(c_c=1.0), outcome)["clearance"] == pytest.approx(clearance)


def test_a_failure_pays_for_the_time_until_the_limit():
    late_failure = replace(STEP, flipped=True, decisions=45)
    early_failure = replace(STEP, flipped=True, decisions=3)
    assert terms_of(Reward(), late_failure)["time"] == -6.0
    # Of the 47 decisions left, only those within failure_seconds count.
    assert terms_of(Reward(), early_failure)["time"] == -1.0 - 20.0
    assert terms_of(Reward(failure_seconds=11.0), early_failure)["time"] == -1.0 - 5.5
    assert terms_of(Reward(), replace(STEP, timeout=True))["time"] == -1.0


def test_times_are_scaled_by_the_pace_of_the_robot():
    """For a robot four times slower, a course and a failure have the same relative cost."""
    everything = Reward(exact_time=True, c_c=0.1)
    terms = terms_of(everything, STEP, pace=4.0)
    assert terms == approx_terms(time=-0.25, progress=0.9, clearance=-0.0625, collision=0.0)

    small_robots_progress = terms_of(Reward(), STEP, scale=1.0)["progress"]
    large_robots_progress = terms_of(Reward(), STEP, scale=2.0)["progress"]
    assert small_robots_progress == 2.0 * large_robots_progress != 0.0

    fallen = replace(STEP, flipped=True, decisions=3)
    assert terms_of(Reward(), STEP, pace=4.0)["time"] == -0.25
    assert terms_of(Reward(failure_seconds=11.0), fallen, pace=4.0)["time"] == -0.25 - 5.5
    # Limited by the time left
    assert terms_of(Reward(), fallen, pace=4.0)["time"] == -0.25 - 47 / 4

    husky = DimensionlessEncoding(robots.load("husky"), 1.0)  # .68 m wide, 1 m/s
    _, terms = Reward(exact_time=True)(STEP, 50, PERIOD, husky)
    assert terms["time"] == pytest.approx(-1.0 / (0.68 / 0.53 * 2.0))


# -- the environment -------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def env():
    """Return an environment of two worlds with episodes of three decisions."""
    import training.env.env

    environment = gymnasium.make(
        training.env.ID,
        worlds="generated:0,generated:1",
        simulator="kinematic",
        time_limit=6.0,
    )
    yield environment
    environment.close()


def test_the_environment_made_by_name_passes_gymnasiums_check():
    from gymnasium.utils.env_checker import check_env

    environment_id = "training.env:applr_ros1/Navigation-v0"
    environment = gymnasium.make(environment_id, worlds="generated:7", time_limit=4.0)
    check_env(environment.unwrapped)
    environment.close()


def test_the_same_seed_gives_the_same_episode(env):
    def run(seed):
        """Return all numbers of an episode with random actions, and its last info."""
        rng = np.random.default_rng(0)
        observation, info = env.reset(seed=seed)
        numbers = [observation]
        truncated = False
        while not truncated:
            action = rng.uniform(-1, 1, 8).astype(np.float32)
            observation, reward, terminated, truncated, info = env.step(action)
            assert not terminated
            numbers += [observation, [reward]]
        return np.concatenate(numbers), info

    numbers, info = run(5)
    repeated, info_again = run(5)
    of_other_seed, _ = run(6)
    assert np.array_equal(repeated, numbers)
    assert info_again["world"] == info["world"]
    assert info["timeout"]
    assert info["decisions"] == 3
    assert not np.array_equal(of_other_seed, numbers)


def test_the_seed_or_an_option_chooses_the_world(env):
    drawn_worlds = set()
    for seed in range(12):
        _, info = env.reset(seed=seed)
        drawn_worlds.add(info["world"])
    assert drawn_worlds == {"generated:0", "generated:1"}

    for seed in range(6):
        _, info = env.reset(seed=seed, options={"world": 1})
        assert info["world"] == "generated:1"


def test_theta_in_the_observation_is_in_force_in_the_planner(env):
    env.reset(seed=0)
    action = np.array([0.3, -0.2, 0.13, 0.4, -0.9, 1.0, -1.0, 0.5], np.float32)

    observation, *_, info = env.step(action)

    encoding = PaperEncoding(JACKAL)
    theta = encoding.theta(action)
    assert np.allclose(info["theta"], theta)
    np.testing.assert_allclose(observation[721:], encoding.action(theta), atol=1e-6)

    configuration = env.unwrapped.simulated.stack.move_base.configuration("TrajectoryPlannerROS")
    max_vel_x, max_vel_theta, vx_samples, *_ = theta
    assert configuration["max_vel_x"] == pytest.approx(max_vel_x)
    assert configuration["min_vel_theta"] == pytest.approx(-max_vel_theta)
    assert configuration["vx_samples"] == vx_samples
    assert set(info["reward"]) == set(TERMS)


@pytest.mark.heavy
@pytest.mark.parametrize(("period", "limit"), [(2.0, 50), (0.5, 200)])
def test_the_decision_period_changes_the_steps_but_not_the_cost_of_a_second(period, limit):
    from training.env.env import ApplrEnv

    env = ApplrEnv(worlds="generated:0", period=period, reward={"exact_time": True})
    env.reset(seed=1)
    action = env.encoding.action(env.space.theta0)
    time_cost = 0.0
    time_s = 0.0
    terminated = False
    while not terminated:
        last_decision_s = time_s
        _, _, terminated, truncated, info = env.step(action)
        assert not truncated
        time_s = info["time_s"]
        time_cost += info["reward"]["time"]
        # The last step ends with the course.
        assert terminated or time_s - last_decision_s == pytest.approx(period)
    env.close()
    assert info["success"]
    assert env.course_drive.limit == limit
    # The paper's period is 2 s.
    assert time_cost == pytest.approx(-time_s / 2.0)
    assert info["decisions"] - 1 < time_s / period <= info["decisions"] + 1e-6


@pytest.mark.parametrize(
    ("protocol", "end_on_collision", "ends"),
    [
        ("paper", False, False),
        ("paper", True, True),
        ("barn-challenge", False, True),
    ],
)
def test_a_contact_ends_an_episode_under_the_challenges_rules_or_if_asked(
    protocol, end_on_collision, ends
):
    from training.env.env import ApplrEnv

    env = ApplrEnv(
        worlds="generated:7", protocol=protocol, end_on_collision=end_on_collision, period=2.0
    )
    env.reset(seed=0)
    assert env.course_drive.rules.end_on_contact == ends


def test_the_decision_period_is_a_multiple_of_the_control_cycle():
    from training.env.env import ApplrEnv

    with pytest.raises(ValueError, match="multiple of 0.05"):
        ApplrEnv(worlds="generated:0", period=0.07)


@pytest.mark.parametrize("movers", [False, True])
def test_the_costmaps_get_predicted_obstacle_points_if_the_settings_request_them(movers):
    from training.env.env import ApplrEnv

    def predicted_points():
        """Return the number of points of all sources besides the laser."""
        (layer,) = env.simulated.stack.move_base.local_costmap.obstacle_layers
        _, *other_buffers = layer.buffers
        point_count = 0
        for buffer in other_buffers:
            for cloud in buffer.clouds:
                point_count += len(cloud.points)
        return point_count

    env = ApplrEnv("dynamic:401", period=1.0, movers=movers)
    for _ in range(2):
        env.reset(seed=0)
        assert predicted_points() == 0, "the tracker has no moving obstacle yet"
        for _ in range(3):
            env.step(np.zeros(env.action_space.shape, np.float32))
        assert (predicted_points() > 20) == movers
    env.close()


@pytest.mark.parametrize(("obstacle_range", "in_force"), [(None, 2.5), (5.0, 5.0)])
def test_an_environment_marks_obstacles_as_far_as_its_settings_say(obstacle_range, in_force):
    from training.env.env import ApplrEnv

    env = ApplrEnv("generated:7", period=1.0, obstacle_range=obstacle_range)
    move_base = env.simulated.stack.move_base
    for costmap in (move_base.global_costmap, move_base.local_costmap):
        (buffer,) = costmap.obstacle_layers[0].buffers
        assert buffer.source.obstacle_range == in_force
    env.close()


def test_a_course_begins_without_a_scan_of_the_previous_course():
    env = gymnasium.make(
        "training.env:applr_ros1/Navigation-v0",
        worlds="generated:7",
        simulator="kinematic",
        observation="dimensionless",
        period=1.0,
    )
    env.reset(seed=0)
    on_its_way, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    at_begin, _ = env.reset(seed=1)
    # This encoding has the scan of the decision before, too, which at first is the same.
    beam_count = env.unwrapped.encoding.scan
    for observation, is_repeated in ((on_its_way, False), (at_begin, True)):
        scan, earlier_scan = np.split(observation[:beam_count], 2)
        assert np.array_equal(scan, earlier_scan) == is_repeated
    env.close()
