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
    y = -1.5
    way = 1.0

    def _publish_pose(self, stamp):
        if self.walks:
            self.y += 0.02 * self.way  # This method is called every 20 ms.
            self.way = -self.way if abs(self.y) > 1.5 else self.way
        self.robot.circles = np.array([*WALL, (1.8, self.y, 0.25)])
        super()._publish_pose(stamp)


def test_a_walker_is_predicted_and_nothing_is_published_at_rest():
    ros = session()
    jackal = Walker(WALL)
    node = ros.node("movers")
    clouds = []
    shown = []
    tracked = []
    rospy.Subscriber("/applr/tracked", Movers, tracked.append)
    rospy.Subscriber("/applr/predicted", PointCloud2, clouds.append)
    rospy.Subscriber("/applr/movers", MarkerArray, lambda message: shown.append(message.markers))
    try:
        node.until(lambda: len(clouds) > 5 and shown and tracked)
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
            rows = zip(message.x, message.vx, message.vy, message.radius)
            is_tracked = any(row == person for row in rows)

            # Predicted points reach as far as the person walks in a second.
            marked = points_of(clouds[-1])
            is_predicted = len(marked) > 0 and marked[:, 1].max() > jackal.y + 0.5

            # RViz shows the same points, and an arrow as long as the person walks in a second.
            points, *arrows = shown[-1]
            is_shown = any(point.y > jackal.y + 0.5 for point in points.points)
            lengths = [arrow.points[1].y - arrow.points[0].y for arrow in arrows]
            return is_tracked and is_predicted and is_shown and 0.6 < max(lengths, default=0) < 1.4

        wait_for(shows_the_walk, "the predicted obstacle points")
        jackal.walks = False
        wait_for(lambda: not clouds[-1].width, "an empty cloud")
        assert "Traceback" not in node.text
    finally:
        assert node.end() == 0, node.text
        jackal.close()
