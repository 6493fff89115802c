"""Drawn robots: they are as a robot.yaml could describe them, differ, and drive."""

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.dimensionless import PARAMETERS, DimensionlessForm
from applr_ros1.robots import JACKAL
from applr_ros1.robots.mistakes import contradictions
from training.env import drawn_robots
from training.env.env import ApplrEnv


def test_robots_span_what_they_should_and_contradict_nothing():
    rng = np.random.default_rng(3)
    robots = [drawn_robots.draw_another(rng) for _ in range(60)]
    for robot in robots:
        assert not contradictions(robot)
    widths = [DimensionlessForm(robot, 1.0).width for robot in robots]
    assert 0.17 < min(widths) < 0.25
    assert 0.75 < max(widths) < 1.0
    assert {robot.base.drive for robot in robots} == {"skid_steer", "two_wheel"}
    assert len({robot.parameters()["base_local_planner"] for robot in robots}) == 2
    shares = np.mean([drawn_robots.draw(rng) is JACKAL for _ in range(400)])
    assert 0.25 < shares < 0.45


def test_each_episode_has_another_robot_and_depends_on_its_seed_only():
    def drive(env, seed):
        observation, _ = env.reset(seed=seed)
        rewards = [env.step(np.full(len(PARAMETERS), 0.1, np.float32))[1] for _ in range(2)]
        return env.episode.robot, observation, rewards

    options = {"worlds": "generated:learn,dynamic:100", "robot": "drawn", "observation": "dimensionless", "period": 1.0}
    env = ApplrEnv(**options)
    assert env.observation_space.shape == env.reset(seed=0)[0].shape
    first, again = drive(env, 1), drive(ApplrEnv(**options), 1)
    np.testing.assert_array_equal(first[1], again[1])
    assert first[2] == again[2]
    assert len({id(drive(env, seed)[0]) for seed in range(6)}) > 2
    with pytest.raises(ApplrError, match="dimensionless"):
        ApplrEnv(robot="drawn", period=1.0)
