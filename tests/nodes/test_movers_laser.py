"""Tests of the movers node without a ROS master: its messages while a person walks by, and the
laser that it tracks if several share its topic.
"""

import numpy as np
import pytest
import rospy

from applr_ros1.common.scan import LaserScan
from applr_ros1.nodes.conversions import points_of
from applr_ros1.nodes.movers import node as module
from applr_ros1.nodes.movers.node import MoversNode, TrackedLaser
from applr_ros1.robots import JACKAL
from tests.support.nodes import mount_laser, sense
from tests.support.robots import ToyRobot, ring

pytest_plugins = ("tests.support.offline_ros",)
# A round room of 3.5 m, so that the person walks in front of something.
WALL = ring(0.0, 0.0, 3.5, posts=250, size=0.06)


def test_a_walker_is_predicted_and_nothing_is_published_at_rest(offline_ros, monkeypatch):
    # Given: a robot at rest, and a person of whom every look of the node shows another tenth of a
    # second
    robot = ToyRobot(circles=[*WALL, (1.8, -1.5, 0.25)])
    looks = 0

    def look(_):
        nonlocal looks
        looks += 1
        if 10 < looks <= 30:
            robot.circles[-1, 1] += 0.1  # 1 m/s to the left
        offline_ros.now += 0.1
        sense(offline_ros, robot)

    monkeypatch.setattr(module.time, "sleep", look)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: looks == 60)
    node = MoversNode(JACKAL, "")
    mount_laser(offline_ros)

    # When
    node.spin()

    # Then: before it walks, nothing moves
    clouds = offline_ros.published["applr/predicted"]
    tracked = offline_ros.published["applr/tracked"]
    marker_arrays = offline_ros.published["applr/movers"]
    assert not any(cloud.width for cloud in clouds[:10])
    # While it walks, it is tracked; the predicted points reach as far as it walks in a second.
    walking = tracked[29]
    person = (walking.x[0], walking.vx[0], walking.vy[0], walking.radius[0])
    assert person == pytest.approx((1.8, 0.0, 1.0, 0.25), abs=0.3)
    y = -1.5 + 0.1 * 20
    assert points_of(clouds[29])[:, 1].max() > y + 0.5
    # RViz shows the same points, and an arrow as long as the person walks in a second.
    point_marker, arrow = marker_arrays[29].markers
    assert any(point.y > y + 0.5 for point in point_marker.points)
    assert 0.6 < arrow.points[1].y - arrow.points[0].y < 1.4
    # It stands again.
    assert not clouds[-1].width
    assert not len(tracked[-1].x)
    for message in (clouds[-1], tracked[-1]):
        assert message.header.frame_id == "odom"


def scan_of(frame, stamp):
    """Return an empty scan of a laser's frame at a time [s]."""
    return LaserScan(stamp, -1.0, 1.0, 0.1, 10.0, np.ones(3), (0.0, 0.0, 0.0), frame=frame)


def test_one_laser_is_tracked_until_it_falls_silent():
    laser = TrackedLaser()
    tracked = []
    changes = []

    def add(frame, stamp):
        scan = scan_of(frame, stamp)
        if laser.switches_to(scan):
            changes.append((frame, stamp))
        if laser.takes(scan):
            tracked.append((frame, stamp))

    # The first scan on the topic is that of a stray, which sends no more.
    add("stray", 0.0)
    for tenths in range(1, 30):
        add("front", tenths / 10)
        add("rear", tenths / 10 + 0.05)
    assert changes == [("stray", 0.0), ("rear", 1.05)]
    assert tracked[1:] == [("rear", tenths / 10 + 0.05) for tenths in range(10, 30)]

    # After a jump of the clock to an earlier time, the same laser is tracked, or else the next one.
    laser.forget_tracks()
    add("front", 0.5)
    add("rear", 0.6)
    assert changes[2:] == [("front", 0.5)]
    assert tracked[-1] == ("front", 0.5)
