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
        latest_time = time.monotonic()
        while not self._over.wait(0.05):
            elapsed = time.monotonic() - latest_time
            latest_time += elapsed
            if self.drifts:
                x, y, yaw = self.pose
                self.pose = x + 0.04 * elapsed, y - 0.02 * elapsed, yaw + 0.01 * elapsed
            stamp = self._jackal.now()
            tolerance = rospy.Duration(1.0)
            map_to_odom = transform("map", "odom", self.pose, stamp + tolerance)
            map_to_door = transform("map", "door", (2.1, 1.5, math.pi / 2), stamp)
            publisher.publish(TFMessage([map_to_odom, map_to_door]))
        publisher.unregister()

    def close(self):
        self._over.set()
        self._thread.join(2.0)


def served(static_map):
    """Publish a StaticMap on /map, latched, like map_server. Return the publisher."""
    grid = OccupancyGrid()
    grid.header.frame_id = static_map.frame
    grid.info.resolution = static_map.resolution
    row_count, column_count = static_map.cells.shape
    grid.info.height = row_count
    grid.info.width = column_count
    origin_x, origin_y = static_map.origin
    grid.info.origin.position.x = origin_x
    grid.info.origin.position.y = origin_y
    grid.data = static_map.cells.ravel().tolist()
    publisher = rospy.Publisher("/map", OccupancyGrid, queue_size=1, latch=True)
    publisher.publish(grid)
    return publisher


@pytest.mark.slow
def test_a_goal_in_the_map_is_reached_while_localisation_drifts():
    master = ros.session()
    parameters = copy.deepcopy(JACKAL_PARAMETERS)
    global_costmap = parameters["global_costmap"]
    global_costmap.update(
        global_frame="map",
        plugins=[{"name": "static", "type": "costmap_2d::StaticLayer"}, *global_costmap["plugins"]],
    )
    jackal = FakeJackal([(1.2, 1.6, 0.15)])  # a post that is not in the map
    localisation = Localisation(jackal)
    node = start(master, parameters)
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
    end_x, end_y, end_yaw = compose(localisation.pose, jackal.robot.pose)
    assert math.hypot(end_x - 4.0, end_y - 1.0) < 0.35
    assert abs(end_yaw) < 0.25
    assert localisation.pose[0] > 0.5  # The odometry has drifted by 0.2 m.
    latest_messages = [collected.messages[-1] for collected in subscriptions]
    costmap_info = latest_messages[0].info
    assert (costmap_info.width, costmap_info.height) == (200, 120)
    # The local planner works in the frame of the odometry, which does not jump.
    assert [message.header.frame_id for message in latest_messages] == ["map", "map", "odom"]
    localisation.drifts = False

    # A metre beyond the door, along the frame's y axis.
    client.send_goal(goal(0.0, -1.0, frame="door"))
    assert finish(client) == (SUCCEEDED, "Goal reached.")
    end_position = compose(localisation.pose, jackal.robot.pose)[:2]
    assert math.dist(end_position, (3.1, 1.5)) < 0.35
    publisher.unregister()
    for collected in subscriptions:
        collected.subscriber.unregister()
    localisation.close()
    jackal.close()
    assert node.end() == 0, node.text
    assert "Traceback" not in node.text
