"""Publishers for RViz and other displays: costmaps and their updates, footprints, plans and clouds.

Called by the move_base node after each cycle. Messages without subscribers are not created.
"""

from __future__ import annotations

import threading
from typing import Any, Callable, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PolygonStamped
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import PointCloud2

from applr_ros1.nodes import conversions
from applr_ros1.nodes.conversions import COST_FIELDS, TRAJECTORY_FIELDS
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.grid import union
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.layers import COSTMAPS

TRAJECTORIES_HZ = 5.0  # rate of trajectory_cloud for planners that have none in C++ [Hz]


class CostmapDisplay(rospy.SubscribeListener):  # type: ignore[misc]  # ROS packages have no type hints.
    """Topics `costmap`, `costmap_updates` and `footprint` of one costmap (docs/explanation/planner.md, section 3.7).

    Args:
        name: Name of the costmap, local_costmap or global_costmap.
        move_base: The MoveBase.
        lock: Lock that is held while the costmap is read.
    """

    def __init__(self, name: str, move_base: MoveBase, lock: threading.RLock):
        super().__init__()
        self._name, self._move_base, self._lock = name, move_base, lock
        static = move_base.parameters[name]
        self._frame, self._always_whole = (
            static["global_frame"].lstrip("/"),
            static["always_send_full_costmap"],
        )
        self._sent = float("-inf")
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
        if costmap.window is not None:
            self._window = (
                costmap.window if self._window is None else union(self._window, costmap.window)
            )
        if self._footprint.get_num_connections():
            outline = footprint.transform(costmap.footprint, *pose)
            self._footprint.publish(conversions.polygon(outline, self._frame, stamp))
        frequency, now = (
            self._move_base.configuration(self._name)["publish_frequency"],
            stamp.to_sec(),
        )
        if frequency <= 0.0 or 0.0 <= now - self._sent <= 1.0 / frequency:
            return
        self._sent = now
        if not (self._whole.get_num_connections() or self._updates.get_num_connections()):
            return
        shape = tuple(costmap.origin), costmap.size, costmap.resolution
        if self._always_whole or shape != self._shape:
            self._send_whole(self._whole.publish, stamp)
        elif self._window is not None:
            x0, y0, xn, yn = self._window
            corner = max(0, x0), max(0, y0)
            cells = costmap.cells[corner[1] : yn, corner[0] : xn]
            self._updates.publish(conversions.grid_update(cells, corner, self._frame, stamp))
        self._shape, self._window = shape, None

    def _send_whole(self, publish: Callable[[Any], None], stamp: Any = None) -> None:
        costmap = self._move_base.costmaps[self._name]
        publish(conversions.grid(costmap, self._frame, stamp or rospy.Time.now()))


class PlanDisplay:
    """Topics of the plans: NavfnROS/plan, and global_plan, local_plan and clouds of the local planner."""

    def __init__(self, move_base: MoveBase):
        name, static = move_base.local_planner_name, move_base.parameters
        self._static = static[name]
        self._global_frame, self._frame = (
            static[costmap]["global_frame"].lstrip("/") for costmap in COSTMAPS
        )
        self._plan = rospy.Publisher("~NavfnROS/plan", Path, queue_size=1)
        self._global, self._local = (
            rospy.Publisher(f"~{name}/{topic}", Path, queue_size=1)
            for topic in ("global_plan", "local_plan")
        )
        self._costs = rospy.Publisher(f"~{name}/cost_cloud", PointCloud2, queue_size=1)
        self._trajectories = rospy.Publisher(f"~{name}/trajectory_cloud", PointCloud2, queue_size=1)
        self._sent = float("-inf")  # time of the last trajectory_cloud [s]

    def planned(self, plan: np.ndarray, stamp: rospy.Time) -> None:
        """Publish the plan (n, 3) of the global planner; it is empty if planning failed."""
        self._send(self._plan, plan, stamp, self._global_frame)

    def controlled(self, local_planner: Any, costmap: Any, stamp: rospy.Time) -> None:
        """Publish the local planner's paths and clouds. Empty paths are not sent, so that displays keep the old one."""
        for publisher, poses in (
            (self._global, local_planner.cropped_plan),
            (self._local, local_planner.local_plan),
        ):
            if len(poses):
                self._send(publisher, poses, stamp, self._frame)
        if self._static["publish_cost_grid_pc"] and self._costs.get_num_connections():
            rows = local_planner.cost_cloud(costmap)
            if len(rows):
                self._costs.publish(conversions.cloud(rows, COST_FIELDS, self._frame, stamp))
        self._show_trajectories(local_planner, costmap, stamp)

    def _show_trajectories(self, local_planner: Any, costmap: Any, stamp: rospy.Time) -> None:
        """Publish the trajectories in each cycle if C++ does (publish_traj_pc), or at TRAJECTORIES_HZ."""
        period = 0.0 if "publish_traj_pc" in self._static else 1.0 / TRAJECTORIES_HZ - 1e-3
        wanted = self._trajectories.get_num_connections() and self._static.get(
            "publish_traj_pc", True
        )
        if not wanted or 0.0 <= stamp.to_sec() - self._sent < period:
            return
        rows = local_planner.trajectory_cloud(costmap)
        if len(rows):
            self._sent = stamp.to_sec()
            frame = self._static.get("global_frame_id", self._frame)
            self._trajectories.publish(conversions.cloud(rows, TRAJECTORY_FIELDS, frame, stamp))

    def _send(
        self, publisher: rospy.Publisher, poses: np.ndarray, stamp: rospy.Time, frame: str
    ) -> None:
        if publisher.get_num_connections():
            publisher.publish(conversions.path(poses, frame, stamp))
