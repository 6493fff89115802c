"""Tests of the robot's description in a bag of the black box."""

from dataclasses import replace

import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import TopicNames
from applr_ros1.robots import JACKAL, NAMES, load
from applr_ros1.why.black_box.description import (
    DescribedRobot,
    described_by,
    text_of,
    unknown_robot,
)

TEB = {
    "base_local_planner": "teb_local_planner/TebLocalPlannerROS",
    "TebLocalPlannerROS": {"max_vel_x": 0.4, "max_vel_theta": 0.3},
    "local_costmap": {"robot_base_frame": "robot1/base", "footprint": [[1, 1], [1, -1], [-1, 0]]},
}


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_is_described_by_a_text(name):
    robot = load(name)
    topics = TopicNames.of(robot)
    read_back = described_by(text_of(DescribedRobot(robot, topics, True)), "stop.bag")
    assert read_back.topics == topics
    assert read_back.is_known
    assert read_back.robot.name == name
    # The policy and the tuned set of an included robot are at hand.
    assert read_back.robot.folder == robot.folder
    for field in ("base", "body", "laser", "frames", "simulation", "monitor", "topics"):
        assert getattr(read_back.robot, field) == getattr(robot, field), field
    assert read_back.robot.space == robot.space
    assert read_back.robot.world_scale == robot.world_scale
    assert read_back.robot.all_parameters() == robot.all_parameters()


def test_no_file_beside_a_bag_is_taken_for_one_of_the_robots():
    driven = DescribedRobot(replace(JACKAL, name="mine"), TopicNames(), True)
    assert described_by(text_of(driven), "stop.bag").robot.folder == "stop.bag"


def test_of_a_robot_without_a_folder_frames_and_size_follow_from_the_parameters():
    robot = unknown_robot(TEB)
    assert robot.local_planner == "TebLocalPlannerROS"
    assert robot.frames.base == "base"
    assert robot.world_scale == pytest.approx(3.5, abs=0.1)
    text = text_of(DescribedRobot(robot, TopicNames(scan="/scan"), False))
    read_back = described_by(text, "stop.bag")
    assert not read_back.is_known
    assert read_back.topics.scan == "/scan"
    assert read_back.robot.parameters() == TEB
    assert unknown_robot(JACKAL.parameters()).world_scale == pytest.approx(1.0)


def test_parameters_of_any_number_are_read_back_as_they_are():
    tree = {**TEB, "values": {f"value_{number}": number * 1e-5 for number in range(100_001)}}
    text = text_of(DescribedRobot(unknown_robot(tree), TopicNames(), False))
    assert described_by(text, "stop.bag").robot.parameters() == tree


@pytest.mark.parametrize(
    "costmap",
    [{"footprint": "[[0.1,"}, {"robot_radius": "0.2 m"}, {"footprint_padding": [0.1, 0.1, 0.1]}],
)
def test_a_footprint_that_cpp_cannot_read_either_is_no_size(costmap):
    assert unknown_robot({"local_costmap": costmap}).world_scale == 1.0


@pytest.mark.parametrize("text", ["", "5", "[1]", "{robot: 3}", '{"topics": 1, "robot": {}}'])
def test_another_text_is_refused_in_one_line(text):
    with pytest.raises(ApplrError, match=r"stop\.bag"):
        described_by(text, "stop.bag")
