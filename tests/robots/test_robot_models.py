"""Tests of the parameter sets and policies in the robots' folders: `auto` selects them, and the
robots drive.
"""

import shutil
from dataclasses import replace

import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.layers import arranged
from applr_ros1.planner.parameters.obstacle_range import laser_sources
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.policy import methods
from applr_ros1.robots.robot import MoveBaseSetup, number_at
from training.attempts.loaded import loadable_space, move_base_parameters
from training.env.settings import TrialSettings
from training.evaluate import runner
from training.evaluate.trial import plan_trials


@pytest.mark.heavy
@pytest.mark.parametrize("name", robots.NAMES)
def test_auto_drives_in_two_test_worlds(name):
    """Each robot arrives without a collision."""
    trial_runner = runner.TrialRunner(TrialSettings(robot=name, monitor=True))
    # Pairs of name and specification
    test_worlds = [("generated:8", "generated:8"), ("generated:35", "generated:35")]
    for task in plan_trials(test_worlds, [("auto", "auto")], 1, seed=0):
        result = trial_runner.run(task)
        assert result.success, result
        assert not result.collided, result


def test_auto_is_a_robots_policy_else_its_set_else_its_parameters(tmp_path):
    chosen_methods = {name: methods.auto(robots.load(name)) for name in robots.NAMES}
    expected_methods = ["static", "applr", "dwa", "static"]
    assert list(chosen_methods.values()) == expected_methods, chosen_methods

    # A robot with both files. The Jackal's policy will do, because nothing drives here.
    folder = tmp_path / "mine"
    shutil.copytree(robots.load("husky").folder, folder)
    shutil.copy(methods.shipped(methods.POLICY, robots.JACKAL), folder / "applr.safetensors")
    robot = robots.load(str(folder))

    def assert_auto(name):
        assert methods.auto(robot) == name
        assert methods.make("auto", robot).name == name

    # One file after the other goes.
    assert_auto("applr")
    assert methods.make("applr", robot).path == str(folder / "applr.safetensors")
    (folder / "applr.safetensors").unlink()
    assert_auto("static")
    (folder / "static.json").unlink()
    assert_auto("dwa")
    command = r"`./applr train --recipe jackal --robot .*/mine"
    remedies = rf"choose the method dwa, or run {command} --init-from dwa`, and copy best"
    with pytest.raises(ApplrError, match=rf"there is no .*applr.safetensors: .*{remedies}"):
        methods.make("applr", robot)


@pytest.mark.parametrize("name", robots.NAMES)
def test_a_set_loaded_after_the_robots_own_files_is_in_force(name):
    robot = robots.load(name)
    space = loadable_space(robot)
    middle_values = 0.5 * (space.low + space.high)
    theta = space.clip(space.fill(space.chosen_of(middle_values)))
    set_parameters = move_base_parameters(robot, space.as_dict(theta))
    # roslaunch merges what is loaded later over what was loaded before.
    parameters = arranged(merged(robot.parameters(), set_parameters))
    for index, target in space.addresses:
        served_value = number_at(parameters, target.server, target.names)
        assert served_value == target.signed(theta[index])


def test_the_obstacle_range_of_a_set_holds_with_and_without_a_map():
    robot = robots.load("jackal")
    # With a map, the layer of the laser has another name.
    laser = {"data_type": "LaserScan", "topic": "front/scan", "marking": True, "clearing": True}
    mapped_costmap = {
        "plugins": [{"name": "seen", "type": "costmap_2d::ObstacleLayer"}],
        "seen": {"observation_sources": "scan", "scan": laser},
    }
    without_map = robot.parameters()
    with_map = {**without_map, "local_costmap": mapped_costmap}
    robot = replace(robot, move_base=MoveBaseSetup(without_map, with_map))

    tuned = move_base_parameters(robot, {}, obstacle_range=4.0)

    for setup in robot.move_base:
        marked_ranges = [source.obstacle_range for source in laser_sources(merged(setup, tuned))]
        assert marked_ranges == [4.0, 4.0]
