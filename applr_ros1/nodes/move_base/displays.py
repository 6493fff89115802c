"""Publishers for RViz and other displays: costmaps and their updates, footprints, plans and clouds.

Called by the move_base node after each cycle. Messages without subscribers are not created.
"""

from __future__ import annotations

import math
import threading
from typing import Any, Callable, Tuple

import rospy
from geometry_msgs.msg import PolygonStamped
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import PointCloud2

from applr_ros1.common.arrays import Array
from applr_ros1.nodes import conversions
from applr_ros1.nodes.conversions import COST_FIELDS, TRAJECTORY_FIELDS
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.grid import union
from applr_ros1.planner.move_base import MoveBase

TRAJECTORIES_HZ = 5.0  # rate of trajectory_cloud for planners that have none in C++ [Hz]
ROUNDING_S = 1e-3  # tolerance of its period, which stamps meet only nearly [s]


class CostmapDisplay(rospy.SubscribeListener):  # type: ignore[misc]  # ROS has no type hints.
    """Topics `costmap`, `costmap_updates` and `footprint` of one costmap.

    docs/explanation/planner.md, section 3.7, has the rules.

    Args:
        name: Name of the costmap, local_costmap or global_costmap.
        move_base: The MoveBase.
        lock: Lock that is held while the costmap is read.
    """

    def __init__(self, name: str, move_base: MoveBase, lock: threading.RLock):
        super().__init__()
        self._name = name
        self._move_base = move_base
        self._lock = lock
        parameters = move_base.parameters[name]
        self._frame = parameters["global_frame"].lstrip("/")
        self._always_whole = parameters["always_send_full_costmap"]
        self._sent = -math.inf  # time of the last publication [s]
        self._shape: Any = None  # origin, size and resolution of the last whole map
        self._window: Any = None  # union of the update windows since the last publication
        self._updates = rospy.Publisher(
            f"~{name}/costmap_updates", OccupancyGridUpdate, queue_size=10
        )
        self._footprint = rospy.Publisher(f"~{name}/footprint", PolygonStamped, queue_size=1)
        self._whole = rospy.Publisher(
            f"~{name}/costmap", OccupancyGrid, self, queue_size=1, latch=False
        )

    def peer_subscribe(self, topic_name: str, topic_publish: Any, peer_publish: Any) -> None:
        """Send the whole costmap to a new subscriber, between two cycles."""
        with self._lock:
            self._send_whole(peer_publish)

    def updated(self, stamp: rospy.Time, pose: Tuple[float, float, float]) -> None:
        """Publish the topics that are due after an update of the costmap at the robot's pose."""
        costmap = self._move_base.costmaps[self._name]
        # A window grows from update to update until it is published.
        if self._window is None:
            self._window = costmap.window
        elif costmap.window is not None:
            self._window = union(self._window, costmap.window)
        if self._footprint.get_num_connections():
            outline = footprint.transform(costmap.footprint, *pose)
            self._footprint.publish(conversions.polygon(outline, self._frame, stamp))

        # The interval is negative after the clock jumped back.
        frequency = self._move_base.configuration(self._name)["publish_frequency"]
        interval = stamp.to_sec() - self._sent
        if frequency <= 0.0 or 0.0 <= interval <= 1.0 / frequency:
            return
        self._sent = stamp.to_sec()
        if not (self._whole.get_num_connections() or self._updates.get_num_connections()):
            return

        # A subscriber can apply an update only to a map of the same place and size.
        map_shape = (tuple(costmap.origin), costmap.size, costmap.resolution)
        if self._always_whole or map_shape != self._shape:
            self._send_whole(self._whole.publish, stamp)
        elif self._window is not None:
            # The window may begin outside the map.
            first_x, first_y, end_x, end_y = self._window
            first_x = max(0, first_x)
            first_y = max(0, first_y)
            cells = costmap.cells[first_y:end_y, first_x:end_x]
            update = conversions.grid_update(cells, (first_x, first_y), self._frame, stamp)
            self._updates.publish(update)
        self._shape = map_shape
        self._window = None

    def _send_whole(self, publish: Callable[[Any], None], stamp: Any = None) -> None:
        """Pass the whole costmap to `publish`, with the present time unless a stamp is given."""
        costmap = self._move_base.costmaps[self._name]
        publish(conversions.grid(costmap, self._frame, stamp or rospy.Time.now()))


class PlanDisplay:
    """Topics of the plans: NavfnROS/plan, and the local planner's paths and clouds."""

    def __init__(self, move_base: MoveBase):
        planner_name = move_base.local_planner_name
        parameters = move_base.parameters
        self._parameters = parameters[planner_name]
        self._global_frame = parameters["global_costmap"]["global_frame"].lstrip("/")
        self._frame = parameters["local_costmap"]["global_frame"].lstrip("/")
        self._plan = rospy.Publisher("~NavfnROS/plan", Path, queue_size=1)
        self._global = rospy.Publisher(f"~{planner_name}/global_plan", Path, queue_size=1)
        self._local = rospy.Publisher(f"~{planner_name}/local_plan", Path, queue_size=1)
        self._costs = rospy.Publisher(f"~{planner_name}/cost_cloud", PointCloud2, queue_size=1)
        self._trajectories = rospy.Publisher(
            f"~{planner_name}/trajectory_cloud", PointCloud2, queue_size=1
        )
        self._sent = -math.inf  # time of the last trajectory_cloud [s]

    def planned(self, plan: Array, stamp: rospy.Time) -> None:
        """Publish the plan (n, 3) of the global planner; it is empty if planning failed."""
        self._send(self._plan, plan, stamp, self._global_frame)

    def controlled(self, local_planner: Any, costmap: Any, stamp: rospy.Time) -> None:
        """Publish the local planner's paths and clouds."""
        # Empty paths are not sent, so that displays keep the old one.
        if len(local_planner.cropped_plan):
            self._send(self._global, local_planner.cropped_plan, stamp, self._frame)
        if len(local_planner.local_plan):
            self._send(self._local, local_planner.local_plan, stamp, self._frame)
        if self._parameters["publish_cost_grid_pc"] and self._costs.get_num_connections():
            rows = local_planner.cost_cloud(costmap)
            if len(rows):
                self._costs.publish(conversions.cloud(rows, COST_FIELDS, self._frame, stamp))
        self._show_trajectories(local_planner, costmap, stamp)

    def _show_trajectories(self, local_planner: Any, costmap: Any, stamp: rospy.Time) -> None:
        """Publish the trajectories in each cycle if C++ does, or at TRAJECTORIES_HZ."""
        # Only DWAPlannerROS has this cloud in C++, with its parameter publish_traj_pc.
        is_in_cpp = "publish_traj_pc" in self._parameters
        is_wanted = self._parameters.get("publish_traj_pc", True)
        if not is_wanted or not self._trajectories.get_num_connections():
            return
        interval = stamp.to_sec() - self._sent
        if not is_in_cpp and 0.0 <= interval < 1.0 / TRAJECTORIES_HZ - ROUNDING_S:
            return
        rows = local_planner.trajectory_cloud(costmap)
        if len(rows):
            self._sent = stamp.to_sec()
            # C++ stamps the cloud with its parameter global_frame_id instead, which may be another
            # frame than that of the points.
            cloud = conversions.cloud(rows, TRAJECTORY_FIELDS, self._frame, stamp)
            self._trajectories.publish(cloud)

    def _send(
        self, publisher: rospy.Publisher, poses: Array, stamp: rospy.Time, frame: str
    ) -> None:
        """Publish poses (n, 3) as a path if there are subscribers."""
        if publisher.get_num_connections():
            publisher.publish(conversions.path(poses, frame, stamp))
