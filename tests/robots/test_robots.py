"""Tests of the four included robots: descriptions, parameter files and parameter spaces."""

import os
import shutil
from dataclasses import replace

import pytest
import yaml

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.robots.check import fields
from applr_ros1.robots.robot import number_at
from tests.support.robots import JACKAL_PARAMETERS

ROBOTS_FOLDER = os.path.dirname(robots.load("jackal").folder)


@pytest.mark.parametrize("name", robots.NAMES)
def test_shipped_robot_is_whole(name):
    robot = robots.load(name)
    assert robot.name == name
    assert robot is robots.load(robot.folder)
    for costmap in ("local_costmap", "global_costmap"):
        assert robot.parameters()[costmap]["global_frame"] == "odom"
    if name != "jackal":
        assert robot.on_map().parameters()["global_costmap"]["global_frame"] == "map"


def test_jackal_has_the_files_of_the_authors():
    jackal = robots.load("jackal")
    parameters = jackal.parameters()
    parameters["TrajectoryPlannerROS"].pop("y_vels", None)
    assert merged(JACKAL_PARAMETERS, parameters) == JACKAL_PARAMETERS
    with pytest.raises(ApplrError, match="no move_base.with_map"):
        jackal.on_map()


def with_files(folder, **files):
    """Copy the Jackal's folder, add parameter files {name: (text, namespace)}, and return the
    path.
    """
    shutil.copytree(os.path.join(ROBOTS_FOLDER, "jackal"), folder)
    robot_yaml = folder / "robot.yaml"
    description = yaml.safe_load(robot_yaml.read_text())
    for name, (text, namespace) in files.items():
        file_name = name + ".yaml"
        (folder / file_name).write_text(text)
        description["move_base"]["files"].append({"file": file_name, "namespace": namespace})
    robot_yaml.write_text(yaml.safe_dump(description))
    return str(folder)


def test_an_empty_section_of_a_file_holds_nothing(tmp_path):
    empty_sections = ("new:\nlocal_costmap:\n", "")
    filled_section = ("width: 7\n", "new")
    # Read in this order: the second file fills a section that the first one has left empty.
    folder = with_files(tmp_path / "mine", empty=empty_sections, value=filled_section)
    parameters = robots.load(folder).parameters()
    assert parameters["new"] == {"width": 7}
    jackal_parameters = robots.load("jackal").parameters()
    assert parameters["local_costmap"] == jackal_parameters["local_costmap"]


def test_values_that_rqt_reconfigure_saved_are_read(tmp_path):
    config_tag = "!!python/object/new:dynamic_reconfigure.encoding.Config"
    saved_text = (
        f"{config_tag}\n"
        "dictitems:\n"
        "  max_vel_x: 0.7\n"
        f"  groups: {config_tag}\n"
        "    state: []\n"
        "state: []\n"
    )
    folder = with_files(tmp_path / "mine", saved=(saved_text, "TrajectoryPlannerROS"))
    assert robots.load(folder).parameters()["TrajectoryPlannerROS"]["max_vel_x"] == 0.7
    # Only this one tag of Python's is read.
    evil_folder = with_files(tmp_path / "evil", evil=("x: !!python/name:os.system\n", ""))
    with pytest.raises(ApplrError, match="evil.yaml: cannot be read .line 1, column 4"):
        robots.load(evil_folder)


def test_a_robot_whose_mass_lies_right_above_its_axle_stands():
    burger = robots.load("turtlebot3_burger")
    # Two centimetres ahead of the axle, where no caster carries it, it tips over.
    for mass_x, tips_over in ((0.0, False), (0.02, True)):
        body = burger.body.model_copy(update={"com": (mass_x, 0.0, 0.1)})
        problems = list(fields(replace(burger, body=body)))
        assert len(problems) == int(tips_over)
        for problem in problems:
            assert problem.startswith("body.com is ")


def test_each_default_of_robot_yaml_could_be_written_into_the_file():
    """pydantic checks the values of a file, but not its defaults."""
    jackal = robots.load("jackal")
    for section in (jackal.base, jackal.body, jackal.laser, jackal.odometry, jackal.simulation):
        values = section.model_dump()
        for name, field in type(section).model_fields.items():
            if not field.is_required():
                values[name] = field.default
        assert type(section)(**values).model_dump() == values


def test_a_space_that_robot_yaml_does_not_state_follows_from_base_and_body():
    burger = robots.load("turtlebot3_burger")
    max_speed = burger.base.max_speed
    max_yaw_rate = burger.base.max_yaw_rate
    robot_width = max(burger.body.size[1], burger.base.track)
    space = {parameter.name: parameter for parameter in burger.space}
    expected_ranges = {
        "max_vel_x": (0.1 * max_speed, max_speed),
        "max_vel_theta": (0.1 * max_yaw_rate, max_yaw_rate),
        "sim_time": (0.8, 3.0),
        "path_distance_bias": (0.5, 64.0),
        "inflation_radius": (0.15 * robot_width, 3.0 * robot_width),
        "vth_samples": (4.0, 60.0),
    }
    for parameter_name, (lowest, highest) in expected_ranges.items():
        # A range is widened to the value of the robot's files.
        target = space[parameter_name].sets[0]
        file_value = number_at(burger.all_parameters(), target.server, target.names)
        widened_range = (min(lowest, file_value), max(highest, file_value))
        assert space[parameter_name].range == widened_range, parameter_name
    target_names = [target.name for target in space["max_vel_x"].sets]
    assert target_names == ["max_vel_x", "max_vel_trans"]
    assert space["vth_samples"].integer
    assert not space["footprint_padding"].paper


def test_unknown_name_lists_the_robots():
    line = "robot roomba: give husky, jackal, .* or a folder with robot.yaml"
    with pytest.raises(ApplrError, match=line):
        robots.load("roomba")
