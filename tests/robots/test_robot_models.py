"""Tests of the parameter sets and policies in the robots' folders: `auto` selects them, and the
robots drive.
"""

import shutil

import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import merged
from applr_ros1.planner.parameters.layers import arranged
from applr_ros1.policy import methods
from applr_ros1.robots.robot import number_at
from training.env.settings import TrialSettings
from training.evaluate import runner
from training.evaluate.loaded import loadable_space, move_base_parameters
from training.evaluate.trial import plan_trials


@pytest.mark.parametrize("name", robots.NAMES)
def test_auto_drives_in_two_test_worlds(name):
    """Each robot arrives without a collision."""
    names = [(world, world) for world in ("generated:8", "generated:35")]
    driver = runner.TrialRunner(TrialSettings(robot=name, monitor=True))
    results = [driver.run(task) for task in plan_trials(names, [("auto", "auto")], 1, seed=0)]
    assert all(result.success and not result.collided for result in results), results


def test_auto_is_a_robots_policy_else_its_set_else_its_parameters(tmp_path):
    assert [methods.auto(robots.load(name)) for name in robots.NAMES] == [
        "static",
        "applr",
        "dwa",
        "static",
    ]
    folder = tmp_path / "mine"
    shutil.copytree(robots.load("husky").folder, folder)
    shutil.copy(methods.shipped(methods.POLICY, robots.JACKAL), folder / "applr.safetensors")
    robot = robots.load(str(folder))
    for file, name in (("applr.safetensors", "applr"), ("static.json", "static"), ("", "dwa")):
        assert methods.auto(robot) == methods.make("auto", robot).name == name
        if name == "applr":
            assert methods.make("applr", robot).path == str(folder / file)
        (folder / file).unlink() if file else None
    with pytest.raises(
        ApplrError,
        match=r"there is no .*applr.safetensors: .*`./applr tune .*/mine`, .*--robot .*/mine`$",
    ):
        methods.make("applr", robot)


@pytest.mark.parametrize("name", robots.NAMES)
def test_a_set_loaded_after_the_robots_own_files_is_in_force(name):
    robot = robots.load(name)
    space = loadable_space(robot)
    theta = space.clip(space.fill(space.chosen_of(0.5 * (space.low + space.high))))
    tree = arranged(merged(robot.parameters(), move_base_parameters(robot, space.as_dict(theta))))
    for index, target in space.addresses:
        assert number_at(tree, target.server, target.names) == target.signed(theta[index])
