"""The sets and policies in the robots' folders: each is found by the robot's name, and no other robot takes it."""

import os
import shutil

import pytest

from applr_ros1 import robots
from applr_ros1.common.trees import merged
from applr_ros1.planner.parameters.layers import arranged
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots.description import find
from training.env.settings import TrialSettings
from training.evaluation import trials
from training.evaluation.plan import plan_trials
from training.tune.parameter_file import move_base_parameters

OTHERS = ["husky", "turtlebot3_waffle_pi"]


def test_one_policy_drives_every_robot():
    """Each robot arrives in two test worlds with it, and nothing is touched."""
    path = methods.shipped()
    assert os.path.getsize(path) < 6e6
    names = [(world, world) for world in ("generated:8", "generated:35")]
    for name in robots.NAMES:
        runner = trials.TrialRunner(TrialSettings(robot=name, monitor=True))
        results = [runner.run(task) for task in plan_trials(names, [("every", path)], 1, seed=0)]
        assert all(result.success and not result.collided for result in results), (name, results)


def test_a_robots_own_policy_goes_first(tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(robots.load("husky").folder, folder)
    shutil.copy(methods.shipped(), folder / "applr.safetensors")
    assert methods.make("applr", robots.load(str(folder))).path == str(folder / "applr.safetensors")
    (folder / "applr.safetensors").unlink()
    assert methods.make("applr", robots.load(str(folder))).path == methods.shipped()


@pytest.mark.parametrize("name", robots.NAMES)
def test_a_set_loaded_after_the_robots_own_files_is_in_force(name):
    robot = robots.load(name)
    space = space_of(robot)
    theta = space.clip(0.5 * (space.low + space.high))
    tree = arranged(merged(robot.parameters(), move_base_parameters(robot, space.as_dict(theta))))
    assert [find(tree, t.server, t.names) * t.sign for parameter in space.names for t in space.targets[parameter]] == [
        value for value, parameter in zip(theta, space.names) for _ in space.targets[parameter]
    ]
