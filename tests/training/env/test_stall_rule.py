"""Tests of the stall rule in training: what is stored is the action that was in force."""

from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy

from tests.support.refusals import refused
from tests.support.scenes import small_world
from tests.support.training import Line
from training.env.env import ApplrEnv
from training.train.learner.config import parse
from training.train.td3.td3 import TD3, TD3Options
from training.workers.collect import Collect, collect

# Cell in which the robot has no plan to its goal: walls (x, y, yaw, size_x, size_y) 0.6 m around it
CELL = (
    (0.6, 0.0, 0.0, 0.1, 1.3),
    (-0.6, 0.0, 0.0, 0.1, 1.3),
    (0.0, 0.6, 0.0, 1.3, 0.1),
    (0.0, -0.6, 0.0, 1.3, 0.1),
)


def environment(**options):
    """Return the learning environment with a robot in a cell, which decides every second."""
    world = small_world(boxes=CELL)
    course = replace(world.course, goal=(5.0, 0.0, 0.0))
    return ApplrEnv(
        [replace(world, course=course)],
        observation="dimensionless",
        period=1.0,
        time_limit=20.0,
        **options,
    )


def drive(env, most=40):
    """Drive an episode with the middle of all ranges, and return the infos of its steps."""
    env.reset(seed=1)
    action = np.zeros(env.encoding.actions, np.float32)
    infos = []
    for _ in range(most):
        _, _, terminated, truncated, info = env.step(action)
        infos.append(info)
        if terminated or truncated:
            break
    return infos


def is_given(info):
    """Return whether the given action was in force."""
    return not info["action"].any()


def test_in_a_stall_another_action_is_in_force_and_reported():
    env = environment(stall_rule=True)
    infos = drive(env)

    # The dead end is known after 2 s. If the plan leads ahead, the given action has its turns.
    given = [is_given(info) for info in infos]
    first_replaced = given.index(False)
    assert first_replaced >= 2
    for info in infos:
        if not is_given(info):
            in_force = env.encoding.action(info["theta"])
            assert info["action"] == pytest.approx(in_force, abs=1e-6)
            assert info["action"].dtype == np.float32

    # The planner had these values, and the costmaps were cleared as on the robot.
    decisions = env.course_drive.drive.decisions
    for decision, info in zip(decisions, infos, strict=True):
        assert decision.after == env.space.as_dict(info["theta"])
    assert [decision.cleared for decision in decisions].index(True) <= first_replaced


def test_the_draws_of_the_rule_depend_on_the_episode():
    env = environment(stall_rule=True)
    thetas = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        for _ in range(9):
            *_, info = env.step(np.zeros(env.encoding.actions, np.float32))
        thetas.append(info["theta"].tolist())
    assert thetas[0] == thetas[2] != thetas[1]


def test_without_the_rule_each_action_is_in_force():
    assert all(is_given(info) for info in drive(environment(), most=14))


@pytest.mark.parametrize(("stall_rule", "reason"), [(False, "stalled"), (True, "time limit")])
def test_a_stall_ends_no_episode_if_the_rule_may_end_the_stall(stall_rule, reason):
    infos = drive(environment(stall_rule=stall_rule, end_on_stall=True))
    assert infos[-1]["reason"] == reason
    assert len(infos) == (20 if stall_rule else 8)


def test_the_papers_policies_drive_without_the_rule():
    refused(lambda: ApplrEnv("generated:0", period=1.0, stall_rule=True), "observation paper")


def test_it_is_an_option_of_a_training(tmp_path):
    options = parse(["--stall-rule", "--observation=dimensionless", "--out", str(tmp_path)])
    assert options.environment()["stall_rule"] is True
    assert parse(["--out", str(tmp_path)]).environment()["stall_rule"] is False


class Replaced(Line):
    """Environment that puts the action 0.5 in force in every second step."""

    def step(self, action):
        in_force = action if self.t % 2 else np.full(1, 0.5, np.float32)
        *result, _ = super().step(in_force)
        return (*result, {"action": in_force})


def test_the_stored_action_is_what_was_in_force():
    weights = TD3(1, 1, TD3Options(net_arch=[8]), seed=0).actor_weights()

    task = Collect(episode=0, seed=0, sigma=0.1, random=False)
    trajectory = collect(Replaced, "{}", task, safetensors.numpy.save(weights))
    assert (trajectory.action[::2] == 0.5).all()
    assert (trajectory.action[1::2] != 0.5).all()
    # It explains the next observation.
    positions = trajectory.rest.ravel()
    assert np.diff(positions) == pytest.approx(0.3 * trajectory.action.ravel(), abs=1e-6)
