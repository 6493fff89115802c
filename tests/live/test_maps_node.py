"""The move_base node with a latched map, localisation that drifts, and goals in other frames."""

import copy
import math
import threading
import time

import actionlib
import pytest
import rospy
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import OccupancyGrid, Path
from tf2_msgs.msg import TFMessage

from applr_ros1.common.angles import compose
from tests.support import ros
from tests.support.nodes import (
    ABORTED,
    SUCCEEDED,
    FakeJackal,
    collect,
    finish,
    goal,
    start,
    transform,
)
from tests.support.robots import JACKAL_PARAMETERS
from tests.support.scenes import wall_with_a_door

pytestmark = pytest.mark.ros


class Localisation:
    """Publisher of a static frame in the map, and of map -> odom, which drifts if `drifts` is set.

    The stamps are 1 s ahead, as those of amcl with the transform_tolerance of Clearpath's launch
    files.
    """

    def __init__(self, jackal):
        self.pose = (0.3, -0.2, 0.4)
        self.drifts = False
        self._jackal = jackal
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        publisher = rospy.Publisher("/tf", TFMessage, queue_size=5)
        latest = time.monotonic()
        while not self._over.wait(0.05):
            passed = time.monotonic() - latest
            latest += passed
            if self.drifts:
                x, y, yaw = self.pose
                self.pose = x + 0.04 * passed, y - 0.02 * passed, yaw + 0.01 * passed
            stamp = self._jackal.now()
            ahead = rospy.Duration(1.0)
            door = transform("map", "door", (2.1, 1.5, math.pi / 2), stamp)
            publisher.publish(TFMessage([transform("map", "odom", self.pose, stamp + ahead), door]))
        publisher.unregister()

    def close(self):
        self._over.set()
        self._thread.join(2.0)


def served(static_map):
    """Publish a StaticMap on /map, latched, like map_server. Return the publisher."""
    message = OccupancyGrid()
    message.header.frame_id = static_map.frame
    message.info.resolution = static_map.resolution
    rows, columns = static_map.cells.shape
    message.info.height = rows
    message.info.width = columns
    x, y = static_map.origin
    message.info.origin.position.x = x
    message.info.origin.position.y = y
    message.data = static_map.cells.ravel().tolist()
    publisher = rospy.Publisher("/map", OccupancyGrid, queue_size=1, latch=True)
    publisher.publish(message)
    return publisher


@pytest.mark.slow
def test_a_goal_in_the_map_is_reached_while_localisation_drifts():
    master = ros.session()
    tree = copy.deepcopy(JACKAL_PARAMETERS)
    global_costmap = tree["global_costmap"]
    global_costmap.update(
        global_frame="map",
        plugins=[{"name": "static", "type": "costmap_2d::StaticLayer"}, *global_costmap["plugins"]],
    )
    jackal = FakeJackal([(1.2, 1.6, 0.15)])  # a post that is not in the map
    localisation = Localisation(jackal)
    node = start(master, tree)
    client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
    assert client.wait_for_server(rospy.Duration(ros.LONGEST))
    # The goal comes before the map, as when map_server starts late.
    client.send_goal(goal(4.0, 1.0, frame="map"))
    node.until("standing still: no map on /map yet: start map_server")
    publisher = served(wall_with_a_door())
    subscriptions = [
        collect("/move_base/global_costmap/costmap", OccupancyGrid),
        collect("/move_base/NavfnROS/plan", Path),
        collect("/move_base/TrajectoryPlannerROS/global_plan", Path),
    ]
    localisation.drifts = True
    assert finish(client) == (SUCCEEDED, "Goal reached.")
    x, y, yaw = compose(localisation.pose, jackal.robot.pose)
    assert math.hypot(x - 4.0, y - 1.0) < 0.35
    assert abs(yaw) < 0.25
    assert localisation.pose[0] > 0.5  # The odometry has drifted by 0.2 m.
    latest_messages = [messages[-1] for _, messages in subscriptions]
    assert (latest_messages[0].info.width, latest_messages[0].info.height) == (200, 120)
    assert [message.header.frame_id for message in latest_messages] == ["map", "map", "odom"]
    localisation.drifts = False

    # A metre beyond the door, along the frame's y axis.
    client.send_goal(goal(0.0, -1.0, frame="door"))
    assert finish(client) == (SUCCEEDED, "Goal reached.")
    x, y, _ = compose(localisation.pose, jackal.robot.pose)
    assert math.hypot(x - 3.1, y - 1.5) < 0.35

    client.send_goal(goal(0.0, 0.0, frame="attic"))
    status, text = finish(client)
    assert status == ABORTED
    assert text.startswith("frame 'attic' cannot be transformed to map: ")
    for endpoint in (publisher, *(subscriber for subscriber, _ in subscriptions)):
        endpoint.unregister()
    localisation.close()
    jackal.close()
    assert node.end() == 0, node.text
    assert "Traceback" not in node.text
