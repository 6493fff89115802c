"""The movers node beside a fake Jackal: what it publishes while somebody walks by, and that it is silent after that."""

import numpy as np
import pytest
import rospy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from applr_ros1.nodes.conversions import points_of
from tests.support.fake_jackal import FakeJackal
from tests.support.ros_harness import session, wait_for
from tests.support.toy_robot import ring

pytestmark = pytest.mark.ros
WALL = ring(0.0, 0.0, 3.5, posts=250, size=0.06)


class Walker(FakeJackal):
    """A Jackal that stands, and somebody who walks to and fro before it at 1 m/s while `walks`."""

    walks, y, way = False, -1.5, 1.0

    def _publish_pose(self, stamp):
        if self.walks:
            self.y += 0.02 * self.way  # every second tick of 10 ms
            self.way = -self.way if abs(self.y) > 1.5 else self.way
        self.robot.circles = np.array([*WALL, (1.8, self.y, 0.25)])
        super()._publish_pose(stamp)


def test_says_where_a_walker_will_be_and_nothing_once_all_stand():
    ros, jackal = session(), Walker(WALL)
    node = ros.node("movers")
    clouds, shown = [], []
    rospy.Subscriber("/applr/predicted", PointCloud2, clouds.append)
    rospy.Subscriber("/applr/movers", MarkerArray, lambda message: shown.append(message.markers))
    try:
        wait_for(lambda: len(clouds) > 5 or not node.alive(), 60.0, "clouds")
        assert node.alive(), node.text
        assert {cloud.header.frame_id for cloud in clouds} == {"odom"}
        assert not any(cloud.width for cloud in clouds), "nothing moves"
        jackal.walks = True

        def met():
            """Marks ahead of one who walks to the left, and an arrow that points there."""
            marked, (points, *arrows) = points_of(clouds[-1]), shown[-1]
            ways = [arrow.points[1].y - arrow.points[0].y for arrow in arrows]
            ahead = [point for point in points.points if point.y > jackal.y + 0.5]
            return len(marked) and marked[:, 1].max() > jackal.y + 0.5 and ahead and 0.6 < max(ways, default=0.0) < 1.4

        wait_for(met, 20.0, "marks")
        jackal.walks = False
        wait_for(lambda: not clouds[-1].width, 10.0, "an empty cloud")
        assert "Traceback" not in node.text
    finally:
        assert node.end() == 0, node.text
        jackal.close()
