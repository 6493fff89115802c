"""Messages to arrays and back, for the move_base node. Pure functions; rospy itself is not needed here.

Big messages (maps, plans, clouds) are written in one piece from their array: `serialize` of the generated classes
packs them number by number, 28 ms for a global map.
"""

from __future__ import annotations

import math
import os
import struct
from typing import Optional

import numpy as np
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped, Quaternion
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from applr_ros1.common.angles import Pose, quaternion_of, yaw_of
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap.scan import LaserScan

MAX_BEAMS = 100000

# costmap value -> occupancy: 0 free, 253 -> 99, 254 -> 100, 255 -> -1, between 1 + 97 (c - 1) / 251
OCCUPANCY = np.array([0] + [1 + (97 * (c - 1)) // 251 for c in range(1, 253)] + [99, 100, -1], np.int8)
CLOUD_FIELDS = ("x", "y", "z", "path_cost", "goal_cost", "occ_cost", "total_cost")


class MessageError(ApplrError):
    """A message that cannot be used; one line says why."""


# -- angles ----------------------------------------------------------------------------------------------------
def is_upright(q) -> bool:
    """Whether a quaternion is finite, not zero, and turns about z only (move_base.cpp, isQuaternionValid)."""
    length2 = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not math.isfinite(length2) or length2 < 1e-6:
        return False
    z_of_z = 1.0 - 2.0 * (q.x * q.x + q.y * q.y) / length2
    return abs(z_of_z - 1.0) <= 1e-3


def pose_of(transform) -> Pose:
    """(x, y, yaw) of a geometry_msgs/Transform."""
    return transform.translation.x, transform.translation.y, yaw_of(transform.rotation)


def pose_stamped(pose: Pose, frame: str, stamp) -> PoseStamped:
    """A geometry_msgs/PoseStamped of pose (x, y, yaw) [m, m, rad] in `frame`."""
    message = PoseStamped()
    message.header.frame_id, message.header.stamp = frame, stamp
    message.pose.position.x, message.pose.position.y = pose[0], pose[1]
    message.pose.orientation = Quaternion(*quaternion_of(pose[2]))
    return message


# -- in --------------------------------------------------------------------------------------------------------
def check_scan(message, beams: Optional[int]) -> np.ndarray:
    """The ranges (n,) float32 of a sensor_msgs/LaserScan; MessageError if the scan cannot be used.

    `beams`: how many its predecessors had, None for any number: a scanner does not change that while driving. NaN, inf
    and -inf beams are ordinary (REP-117); a scan of nothing but NaN is a blind scanner.
    """
    n = len(message.ranges)
    if n == 0 or n > MAX_BEAMS:
        raise MessageError("has %d beams: give between 1 and %d" % (n, MAX_BEAMS))
    if beams is not None and n != beams:
        raise MessageError(
            "has %d beams where it had %d: check the scanner; another one is accepted after two seconds" % (n, beams)
        )
    geometry = (message.angle_min, message.angle_increment, message.range_min, message.range_max)
    if not all(map(math.isfinite, geometry)) or message.angle_increment == 0.0:
        raise MessageError(
            "has angle_min, angle_increment, range_min, range_max = %s: give finite numbers and an "
            "increment" % (geometry,)
        )
    ranges = np.array(message.ranges, dtype=np.float32)
    if np.isnan(ranges).all():
        raise MessageError("is all NaN: check the scanner")
    return ranges


def laser_scan(message, ranges: np.ndarray, sensor_pose: Pose, height: float) -> LaserScan:
    """The planner's scan of a message whose ranges have been checked."""
    return LaserScan(
        message.header.stamp.to_sec(),
        message.angle_min,
        message.angle_increment,
        message.range_min,
        message.range_max,
        ranges,
        sensor_pose,
        height,
    )


# -- out -------------------------------------------------------------------------------------------------------
class PackedMessage:
    """A message whose last field, an array left empty in `message`, goes out as `count` elements of `payload`."""

    _has_header = True

    def __init__(self, message, count: int, payload: bytes):
        self.message, self.header, self._md5sum = message, message.header, message._md5sum
        self.count, self.payload = count, payload

    def serialize(self, buff) -> None:
        """What rospy calls: the message as generated, then the array in place of its zero length."""
        self.message.serialize(buff)
        buff.seek(-4, os.SEEK_CUR)
        buff.write(struct.pack("<I", self.count))
        buff.write(self.payload)


def header(frame: str, stamp) -> Header:
    """A std_msgs/Header."""
    return Header(frame_id=frame, stamp=stamp)


def grid(costmap, frame: str, stamp) -> PackedMessage:
    """The whole costmap as nav_msgs/OccupancyGrid."""
    message = OccupancyGrid(header=header(frame, stamp))
    message.info.map_load_time = stamp
    message.info.resolution = costmap.resolution
    message.info.width, message.info.height = costmap.size
    message.info.origin.position.x, message.info.origin.position.y = (float(v) for v in costmap.origin)
    message.info.origin.orientation.w = 1.0
    return PackedMessage(message, costmap.cells.size, OCCUPANCY[costmap.cells].tobytes())


def grid_update(costmap, window, frame: str, stamp) -> PackedMessage:
    """The cells of a window (x0, y0, xn, yn) as map_msgs/OccupancyGridUpdate."""
    x0, y0, xn, yn = window
    message = OccupancyGridUpdate(header=header(frame, stamp))
    message.x, message.y, message.width, message.height = x0, y0, xn - x0, yn - y0
    cells = costmap.cells[y0:yn, x0:xn]
    return PackedMessage(message, cells.size, OCCUPANCY[cells].tobytes())


def path(poses: np.ndarray, frame: str, stamp) -> PackedMessage:
    """(n, 3) x, y, yaw, or (n, 2) with identity orientation, as nav_msgs/Path."""
    name = frame.encode()
    kind = np.dtype(
        [
            ("seq", "<u4"),
            ("secs", "<u4"),
            ("nsecs", "<u4"),
            ("length", "<u4"),
            ("frame", "S%d" % max(1, len(name))),
            ("pose", "<f8", 7),
        ]
    )
    rows = np.zeros(len(poses), kind)
    rows["secs"], rows["nsecs"], rows["length"], rows["frame"] = stamp.secs, stamp.nsecs, len(name), name
    rows["pose"][:, :2] = poses[:, :2]
    half = 0.5 * poses[:, 2] if poses.shape[1] > 2 else np.zeros(len(poses))
    rows["pose"][:, 5], rows["pose"][:, 6] = np.sin(half), np.cos(half)
    return PackedMessage(Path(header=header(frame, stamp)), len(poses), rows.tobytes())


def polygon(vertices: np.ndarray, frame: str, stamp) -> PolygonStamped:
    """(n, 2) [m] as geometry_msgs/PolygonStamped."""
    message = PolygonStamped(header=header(frame, stamp))
    message.polygon.points = [Point32(float(x), float(y), 0.0) for x, y in vertices]
    return message


def cost_cloud(rows: np.ndarray, frame: str, stamp) -> PointCloud2:
    """(n, 7) x, y, z, path, goal, occupancy and total cost as sensor_msgs/PointCloud2, one point per cell."""
    return _cloud(rows, CLOUD_FIELDS, frame, stamp)


def trajectory_cloud(rows: np.ndarray, frame: str, stamp) -> PointCloud2:
    """(n, 5) x, y, z, theta and cost as sensor_msgs/PointCloud2, one point per point of a trajectory."""
    return _cloud(rows, ("x", "y", "z", "theta", "cost"), frame, stamp)


def _cloud(rows: np.ndarray, names, frame: str, stamp) -> PointCloud2:
    message = PointCloud2(header=header(frame, stamp), height=1, width=len(rows), is_dense=True)
    message.fields = [PointField(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate(names)]
    message.point_step = 4 * len(names)
    message.row_step = message.point_step * len(rows)
    message.data = np.ascontiguousarray(rows, dtype="<f4").tobytes()
    return message
