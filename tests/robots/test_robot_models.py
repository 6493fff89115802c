"""The sets and policies in the robots' folders: each is found by the robot's name, and no other robot takes it."""

import os

import pytest

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import merged
from applr_ros1.policy import methods
from applr_ros1.policy.actor import Actor
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots.description import find
from training.evaluation import trials
from training.static_search import move_base_parameters
from worlds import builtin

TRAINED = ["jackal", "husky", "turtlebot3_waffle_pi"]
OTHERS = [name for name in TRAINED if name != "jackal"]


def test_the_policy_for_every_robot_drives_those_without_their_own():
    """The burger arrives in three test worlds."""
    burger = robots.load("turtlebot3_burger")
    assert methods.make("applr", burger).path == methods.shipped(methods.GENERAL)
    assert os.path.getsize(methods.shipped(methods.GENERAL)) < 6e6
    names = [(world, world) for world in ("generated:8", "generated:35", "generated:123")]
    runner = trials.TrialRunner("kinematic", robot="turtlebot3_burger", monitor=True)
    results = [runner.run(task).result for task in trials.plan(names, [("applr", "applr")], 1, seed=0)]
    assert all(result.success for result in results), results


@pytest.mark.parametrize("name", OTHERS)
def test_the_policy_is_the_robots_own(name):
    robot = robots.load(name)
    path = methods.shipped(robot=robot)
    actor = Actor.load(path, space_of(robot))
    assert actor.layout == layout_of(robot)
    assert actor.metadata["robot"] == name
    assert methods.make("applr", robot).period == actor.period
    options = actor.metadata["training"]["options"]
    assert options["robot"] == name
    assert options["worlds"] == "generated:learn,fresh:0-9999"
    assert not set(builtin.TEST) & set(builtin.VALIDATION)
    with open(path.replace(".safetensors", ".md"), encoding="utf-8") as card:
        assert "training.train --recipe" in card.read()
    for other in TRAINED:
        if other != name:
            with pytest.raises(ApplrError, match='for the robot "%s": here %s runs' % (name, other)) as e:
                methods.make(path, robots.load(other))
            assert "\n" not in str(e.value)


@pytest.mark.parametrize("name", robots.NAMES)
def test_a_set_loaded_after_the_robots_own_files_is_in_force(name):
    robot = robots.load(name)
    space = space_of(robot)
    theta = space.clip(0.5 * (space.low + space.high))
    tree = merged(robot.parameters(), move_base_parameters(robot, space.as_dict(theta)))
    assert [find(tree, t.server, t.names) * t.sign for parameter in space.names for t in space.targets[parameter]] == [
        value for value, parameter in zip(theta, space.names) for _ in space.targets[parameter]
    ]
