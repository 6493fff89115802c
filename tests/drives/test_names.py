"""Tests of the topics of a running robot: those that its move_base reads and writes."""

import pytest

from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.names import Connections, names_beside

TYPES = {
    "/lidar/front": "sensor_msgs/LaserScan",
    "/lidar/rear": "sensor_msgs/LaserScan",
    "/wheel/odometry": "nav_msgs/Odometry",
    "/cmd_vel": "geometry_msgs/Twist",
    "/nav_vel": "geometry_msgs/Twist",
    "/move_base/cmd_vel": "geometry_msgs/Twist",
}
READS = {"/lidar/rear", "/lidar/front", "/wheel/odometry", "/tf"}
NAMES = TopicNames(scan="/scan", odometry="/odom")


@pytest.mark.parametrize(
    ("published", "command"),
    [
        ({"/cmd_vel", "/move_base/status"}, "/cmd_vel"),
        ({"/nav_vel"}, "/nav_vel"),
        # Behind a monitor, the base has its own topic.
        ({"/move_base/cmd_vel"}, "/cmd_vel"),
    ],
)
def test_topics_are_those_of_move_base(published, command):
    names = names_beside(Connections(published, READS), TYPES, NAMES, ())
    assert names.scan == "/lidar/front"
    assert names.odometry == "/wheel/odometry"
    assert names.command == command


def test_names_that_are_given_or_fit_stay():
    connections = Connections({"/nav_vel"}, READS)
    given = TopicNames(scan="/scan", odometry="/odom", command="/base/cmd_vel")
    assert names_beside(connections, TYPES, given, ("scan", "odometry", "command")) == given
    fitting = TopicNames(scan="/lidar/rear", odometry="/odom")
    assert names_beside(connections, TYPES, fitting, ()).scan == "/lidar/rear"
    # A laser that is not there yet keeps its usual name.
    without = Connections(set(), {"/tf"})
    assert names_beside(without, TYPES, NAMES, ()) == NAMES
