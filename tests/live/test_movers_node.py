"""Test of the node movers with a fake Jackal: its messages while a person walks by, and empty
messages afterwards.
"""

import numpy as np
import pytest
import rospy
from applr_ros1.msg import Movers
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from applr_ros1.nodes.conversions import points_of
from tests.support.nodes import FakeJackal
from tests.support.robots import ring
from tests.support.ros import session, wait_for

pytestmark = pytest.mark.ros
# A round room of 3.5 m, so that the person walks in front of something.
WALL = ring(0.0, 0.0, 3.5, posts=250, size=0.06)


class Walker(FakeJackal):
    """A Jackal at rest, and a person who walks to and fro in front of it at 1 m/s while `walks` is
    set.
    """

    walks = False
    y = -1.5  # position of the person [m]
    vy = 1.0  # velocity of the person along y [m/s]

    def publish_pose(self, stamp):
        if self.walks:
            self.y += 0.02 * self.vy  # This method is called every 20 ms.
            # The person turns round.
            if abs(self.y) > 1.5:
                self.vy = -self.vy
        self.robot.circles = np.array([*WALL, (1.8, self.y, 0.25)])
        super().publish_pose(stamp)


def test_a_walker_is_predicted_and_nothing_is_published_at_rest():
    ros = session()
    jackal = Walker(WALL)
    node = ros.node("movers")
    clouds = []
    marker_arrays = []
    tracked = []
    rospy.Subscriber("/applr/tracked", Movers, tracked.append)
    rospy.Subscriber("/applr/predicted", PointCloud2, clouds.append)
    rospy.Subscriber("/applr/movers", MarkerArray, marker_arrays.append)
    try:
        node.until(lambda: len(clouds) > 5 and marker_arrays and tracked)
        assert {cloud.header.frame_id for cloud in clouds} == {"odom"}
        assert not any(cloud.width for cloud in clouds), "nothing moves"
        assert {(message.header.frame_id, len(message.x)) for message in tracked} == {("odom", 0)}
        jackal.walks = True

        def shows_the_walk():
            """Return whether cloud, markers and tracked obstacles all show the person walking to
            the left.
            """
            # Where the person is, its velocity [m/s] and radius [m]
            message = tracked[-1]
            person = pytest.approx((1.8, 0.0, 1.0, 0.25), abs=0.3)
            obstacles = zip(message.x, message.vx, message.vy, message.radius)
            is_tracked = any(obstacle == person for obstacle in obstacles)

            # Predicted points reach as far as the person walks in a second.
            predicted_points = points_of(clouds[-1])
            is_predicted = (
                len(predicted_points) > 0 and predicted_points[:, 1].max() > jackal.y + 0.5
            )

            # RViz shows the same points, and an arrow as long as the person walks in a second.
            point_marker, *arrows = marker_arrays[-1].markers
            has_points = any(point.y > jackal.y + 0.5 for point in point_marker.points)
            arrow_lengths = [arrow.points[1].y - arrow.points[0].y for arrow in arrows]
            has_arrow = 0.6 < max(arrow_lengths, default=0) < 1.4
            return is_tracked and is_predicted and has_points and has_arrow

        wait_for(shows_the_walk, "the predicted obstacle points")
        jackal.walks = False
        wait_for(lambda: not clouds[-1].width, "an empty cloud")
        assert "Traceback" not in node.text
    finally:
        assert node.end() == 0, node.text
        jackal.close()
