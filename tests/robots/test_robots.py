"""Tests of the four included robots: descriptions, parameter files and parameter spaces."""

import os
import shutil
from dataclasses import replace

import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import merged
from applr_ros1.robots.check import fields
from applr_ros1.robots.robot import number_at
from tests.support.robots import JACKAL_PARAMETERS

HERE = os.path.dirname(robots.load("jackal").folder)


@pytest.mark.parametrize("name", robots.NAMES)
def test_shipped_robot_is_whole(name):
    robot = robots.load(name)
    assert robot.name == name
    assert robot is robots.load(robot.folder)
    for costmap in ("local_costmap", "global_costmap"):
        assert robot.parameters()[costmap]["global_frame"] == "odom"
    if name != "jackal":
        assert robot.parameters(with_map=True)["global_costmap"]["global_frame"] == "map"


def test_jackal_has_the_files_of_the_authors():
    jackal = robots.load("jackal")
    of_files = jackal.parameters()
    of_files["TrajectoryPlannerROS"].pop("y_vels", None)
    assert merged(JACKAL_PARAMETERS, of_files) == JACKAL_PARAMETERS
    with pytest.raises(ApplrError, match="no move_base.with_map"):
        jackal.parameters(with_map=True)


def with_files(folder, **files):
    """Copy the Jackal's folder, add parameter files {name: (text, namespace)}, and return the
    path.
    """
    shutil.copytree(os.path.join(HERE, "jackal"), folder)
    description = yaml.safe_load((folder / "robot.yaml").read_text())
    for name, (text, namespace) in files.items():
        (folder / (name + ".yaml")).write_text(text)
        description["move_base"]["files"].append({"file": name + ".yaml", "namespace": namespace})
    (folder / "robot.yaml").write_text(yaml.safe_dump(description))
    return str(folder)


def test_an_empty_section_of_a_file_holds_nothing(tmp_path):
    empty = ("new:\nlocal_costmap:\n", "")
    value = ("width: 7\n", "new")
    tree = robots.load(with_files(tmp_path / "mine", empty=empty, value=value)).parameters()
    assert tree["new"] == {"width": 7}
    assert tree["local_costmap"] == robots.load("jackal").parameters()["local_costmap"]


def test_values_that_rqt_reconfigure_saved_are_read(tmp_path):
    tag = "!!python/object/new:dynamic_reconfigure.encoding.Config"
    text = f"{tag}\ndictitems:\n  max_vel_x: 0.7\n  groups: {tag}\n    state: []\nstate: []\n"
    saved = with_files(tmp_path / "mine", saved=(text, "TrajectoryPlannerROS"))
    assert robots.load(saved).parameters()["TrajectoryPlannerROS"]["max_vel_x"] == 0.7
    # Only this one tag of Python's is read.
    evil = with_files(tmp_path / "evil", evil=("x: !!python/name:os.system\n", ""))
    with pytest.raises(ApplrError, match="could not determine a constructor"):
        robots.load(evil)


def test_a_robot_whose_mass_lies_right_above_its_axle_stands():
    burger = robots.load("turtlebot3_burger")
    # Two centimetres ahead of the axle, where no caster carries it, it tips over.
    for x, tips in ((0.0, False), (0.02, True)):
        body = burger.body.model_copy(update={"com": (x, 0.0, 0.1)})
        problems = list(fields(replace(burger, body=body)))
        assert len(problems) == int(tips)
        for problem in problems:
            assert problem.startswith("body.com is ")


def test_a_space_that_robot_yaml_does_not_state_follows_from_base_and_body():
    burger = robots.load("turtlebot3_burger")
    speed = burger.base.max_speed
    turn = burger.base.max_yaw_rate
    width = max(burger.body.size[1], burger.base.track)
    space = {parameter.name: parameter for parameter in burger.space}
    ranges = {
        "max_vel_x": (0.1 * speed, speed),
        "max_vel_theta": (0.1 * turn, turn),
        "sim_time": (0.8, 3.0),
        "path_distance_bias": (0.5, 64.0),
        "inflation_radius": (0.15 * width, 3.0 * width),
        "vth_samples": (4.0, 60.0),
    }
    for name, (low, high) in ranges.items():
        # A range is widened to the value of the robot's files.
        target = space[name].sets[0]
        of_files = number_at(burger.all_parameters(), target.server, target.names)
        assert space[name].range == (min(low, of_files), max(high, of_files)), name
    targets = [target.name for target in space["max_vel_x"].sets]
    assert targets == ["max_vel_x", "max_vel_trans"]
    assert space["vth_samples"].integer
    assert not space["footprint_padding"].paper


def test_unknown_name_lists_the_robots():
    line = "robot roomba: give husky, jackal, .* or a folder with robot.yaml"
    with pytest.raises(ApplrError, match=line):
        robots.load("roomba")
