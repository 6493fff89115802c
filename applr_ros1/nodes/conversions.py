"""Conversions between ROS messages and arrays, for the nodes. Pure functions that do not need rospy.

Large messages (maps, plans, clouds) are serialized from their array in one piece. The generated classes would pack them
number by number, which takes 28 ms for a global map.
"""

from __future__ import annotations

import math
import os
import struct
from typing import Any, Mapping, Optional, Sequence, Tuple

import numpy as np
from actionlib_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped, Quaternion, Twist, Vector3
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from applr_ros1.common.angles import Pose, quaternion_of, yaw_of
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan, Point, SensorCloud
from applr_ros1.planner.costmap.static_layer import StaticMap

GOAL_STATES = {
    value: name.lower() for name, value in vars(GoalStatus).items() if name.isupper()
}  # {3: "succeeded"}
LEVEL_COS = 1.0 - 2e-6  # smallest cosine of the tilt of a level sensor

# occupancy by costmap value c: 0 stays 0, 253 -> 99, 254 -> 100, 255 -> -1, other values 1 + 97 (c - 1) / 251
OCCUPANCY = np.array(
    [0] + [1 + (97 * (c - 1)) // 251 for c in range(1, 253)] + [99, 100, -1], np.int8
)
COST_FIELDS = (
    "x",
    "y",
    "z",
    "path_cost",
    "goal_cost",
    "occ_cost",
    "total_cost",
)  # fields of cost_cloud (cells)
TRAJECTORY_FIELDS = ("x", "y", "z", "theta", "cost")  # fields of trajectory_cloud (points)


class MessageError(ApplrError):
    """A message that cannot be used. The text gives the reason in one line."""


def is_upright(q: Any) -> bool:
    """Return whether a quaternion is finite, nonzero, and rotates about z only (isQuaternionValid of move_base.cpp)."""
    length2 = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not math.isfinite(length2) or length2 < 1e-6:
        return False
    return bool(2.0 * (q.x * q.x + q.y * q.y) / length2 <= 1e-3)


def pose_of(message: Any) -> Pose:
    """Return (x, y, yaw) of a geometry_msgs/Transform or a geometry_msgs/Pose."""
    if hasattr(message, "position"):
        return message.position.x, message.position.y, yaw_of(message.orientation)
    return message.translation.x, message.translation.y, yaw_of(message.rotation)


def pose_stamped(pose: Pose, frame: str, stamp: Any) -> PoseStamped:
    """Return a geometry_msgs/PoseStamped of the pose (x, y, yaw) [m, m, rad] in `frame`."""
    message = PoseStamped(header=Header(0, stamp, frame))
    message.pose.position.x, message.pose.position.y = pose[0], pose[1]
    message.pose.orientation = Quaternion(*quaternion_of(pose[2]))
    return message


def twist(v: float, w: float) -> Twist:
    """Return a geometry_msgs/Twist of a forward speed v [m/s] and a turn rate w [rad/s]."""
    return Twist(Vector3(v, 0.0, 0.0), Vector3(0.0, 0.0, w))


def diagnostics(
    name: str, level: int, text: str, values: Mapping[str, Any], stamp: Any
) -> DiagnosticArray:
    """Return a diagnostic_msgs/DiagnosticArray with one status and its {key: value} pairs."""
    shown = [
        KeyValue(k, f"{value:.3f}" if isinstance(value, float) else str(value))
        for k, value in values.items()
    ]
    return DiagnosticArray(
        Header(0, stamp, ""), [DiagnosticStatus(level, name, text, "none", shown)]
    )


# -- from messages -----------------------------------------------------------------------------------------------
def check_scan(message: Any, no_return: Optional[float] = None) -> np.ndarray:
    """Return the ranges (n,) float32 of a sensor_msgs/LaserScan. Raises MessageError if the scan cannot be used.

    The range `no_return` becomes +inf. Beams of NaN, inf and -inf are valid (REP 117), but if all are NaN, the scanner
    is blind.
    """
    if not len(message.ranges):
        raise MessageError("has 0 beams")
    geometry = (message.angle_min, message.angle_increment, message.range_min, message.range_max)
    if (
        not all(map(math.isfinite, geometry[:3]))
        or math.isnan(geometry[3])
        or message.angle_increment == 0.0
    ):
        raise MessageError(
            f"has angle_min, angle_increment, range_min, range_max = {geometry}: give finite numbers and an increment"
        )  # laser_geometry accepts an infinite range_max.
    ranges = np.array(message.ranges, dtype=np.float32)
    if np.isnan(ranges).all():
        raise MessageError("is all NaN: check the scanner")
    return (
        ranges
        if no_return is None
        else np.where(ranges == np.float32(no_return), np.float32(np.inf), ranges)
    )


def points_of(message: Any) -> np.ndarray:
    """Return the points (n, 3) float32 of a sensor_msgs/PointCloud2 or PointCloud.

    Raises MessageError if a field is missing, and ValueError or TypeError if the sizes are inconsistent.
    """
    if hasattr(message, "points"):
        return np.array([(p.x, p.y, p.z) for p in message.points], np.float32).reshape(-1, 3)
    if message.width * message.height == 0:
        return np.zeros((0, 3), np.float32)
    offsets = {
        field.name: field.offset for field in message.fields if field.datatype == PointField.FLOAT32
    }
    if not all(axis in offsets for axis in "xyz"):
        given = ", ".join(f"{field.name} (datatype {field.datatype})" for field in message.fields)
        raise MessageError(
            f"has {'the fields ' + given if given else 'no fields'}: give x, y and z as FLOAT32"
        )
    width, order = message.point_step, ">" if message.is_bigendian else "<"
    row = message.row_step if message.height > 1 else message.width * width
    kind = np.dtype(
        {
            "names": list("xyz"),
            "formats": [order + "f4"] * 3,
            "offsets": [offsets[a] for a in "xyz"],
            "itemsize": width,
        }
    )
    table = np.ndarray((message.height, message.width), kind, message.data, 0, (row, width))
    return np.stack([table[axis].ravel() for axis in "xyz"], axis=1).astype(np.float32)


def point_of(transform: Any) -> Point:
    """Return the translation (x, y, z) of a geometry_msgs/Transform."""
    return transform.translation.x, transform.translation.y, transform.translation.z


def _rotation(transform: Any) -> Tuple[float, float, float, float]:
    q = transform.rotation
    return q.x, q.y, q.z, q.w


def cos_tilt(quaternion: Tuple[float, float, float, float]) -> float:
    """Return the cosine of the angle between the z axes before and after a rotation (x, y, z, w)."""
    return 1.0 - 2.0 * (quaternion[0] ** 2 + quaternion[1] ** 2)


def laser_scan(
    message: Any, ranges: np.ndarray, transform: Any, origin: Optional[Point] = None
) -> LaserScan:
    """Convert a message whose ranges have been checked to the planner's scan.

    transform: geometry_msgs/Transform of the laser in the costmap's frame. origin: start of the rays if not the laser.
    """
    quaternion = _rotation(transform)
    upright = cos_tilt(quaternion)
    ranges, first = from_above(message, ranges, upright < -LEVEL_COS)
    stamp, pose, z = message.header.stamp.to_sec(), pose_of(transform), transform.translation.z
    rotation = None if abs(upright) > LEVEL_COS else quaternion
    limits = message.angle_increment, message.range_min, message.range_max
    sweep = abs(message.time_increment) * (len(ranges) - 1)
    return LaserScan(
        stamp, first, *limits, ranges, pose, z, rotation, origin, sweep, message.header.frame_id
    )


def from_above(message: Any, ranges: np.ndarray, hangs: bool) -> Tuple[np.ndarray, float]:
    """Return (ranges, first angle [rad]) of a scan as seen from above. `hangs`: whether the laser is upside down."""
    if not hangs:
        return ranges, message.angle_min
    return ranges[::-1], -(message.angle_min + (len(ranges) - 1) * message.angle_increment)


def sensor_cloud(message: Any, transform: Any, origin: Optional[Point] = None) -> SensorCloud:
    """Convert a sensor_msgs/PointCloud2 or PointCloud to the planner's cloud. Arguments are as for laser_scan."""
    stamp, points, rotation = (
        message.header.stamp.to_sec(),
        points_of(message),
        _rotation(transform),
    )
    return SensorCloud(
        stamp, points, point_of(transform), rotation, origin, message.header.frame_id
    )


def static_map(message: Any) -> StaticMap:
    """Convert a nav_msgs/OccupancyGrid to the planner's map. Raises MessageError if it is inconsistent or rotated."""
    info, n = message.info, len(message.data)
    if info.width * info.height != n or n == 0:
        raise MessageError(f"has {n} cells for {info.width} x {info.height}")
    turn = info.origin.orientation  # Some publishers leave the orientation all zero.
    if is_upright(turn) and abs(yaw_of(turn)) > 1e-3:
        raise MessageError(
            f"has an origin with a yaw of {yaw_of(turn):.3g} rad: give an origin without yaw"
        )
    cells = np.array(message.data, dtype=np.int8).reshape(info.height, info.width)
    place = float(info.origin.position.x), float(info.origin.position.y)
    return StaticMap(cells, float(info.resolution), place, message.header.frame_id.lstrip("/"))


# -- to messages -------------------------------------------------------------------------------------------------
class PackedMessage:
    """Message whose last field is an array: empty in `message`, sent as the `count` elements in the bytes `payload`."""

    _has_header = True

    def __init__(self, message: Any, count: int, payload: bytes):
        self.message, self.header, self._md5sum = message, message.header, message._md5sum
        self.count, self.payload = count, payload

    def serialize(self, buff: Any) -> None:
        """Write the generated message, then replace the empty array at its end."""
        self.message.serialize(buff)
        buff.seek(-4, os.SEEK_CUR)
        buff.write(struct.pack("<I", self.count))
        buff.write(self.payload)


def grid(costmap: Any, frame: str, stamp: Any) -> PackedMessage:
    """Return the whole costmap as a nav_msgs/OccupancyGrid."""
    message = OccupancyGrid(header=Header(0, stamp, frame))
    message.info.map_load_time = stamp
    message.info.resolution = costmap.resolution
    message.info.width, message.info.height = costmap.size
    message.info.origin.position.x, message.info.origin.position.y = (
        float(v) for v in costmap.origin
    )
    message.info.origin.orientation.w = 1.0
    return PackedMessage(message, costmap.cells.size, OCCUPANCY[costmap.cells].tobytes())


def grid_update(
    cells: np.ndarray, corner: Tuple[int, int], frame: str, stamp: Any
) -> PackedMessage:
    """Return the window of cells (h, w) of a costmap at `corner` (x, y) as a map_msgs/OccupancyGridUpdate."""
    message = OccupancyGridUpdate(header=Header(0, stamp, frame))
    (message.x, message.y), (message.height, message.width) = corner, cells.shape
    return PackedMessage(message, cells.size, OCCUPANCY[cells].tobytes())


def path(poses: np.ndarray, frame: str, stamp: Any) -> PackedMessage:
    """Return poses (n, 3) x, y, yaw, or points (n, 2) with identity orientation, as a nav_msgs/Path."""
    name = frame.encode()
    kind = [("header", "<u4", 4), ("frame", f"S{max(1, len(name))}"), ("pose", "<f8", 7)]
    rows = np.zeros(len(poses), kind)
    rows["header"], rows["frame"] = (0, stamp.secs, stamp.nsecs, len(name)), name
    rows["pose"][:, :2] = poses[:, :2]
    half = 0.5 * poses[:, 2] if poses.shape[1] > 2 else np.zeros(len(poses))
    rows["pose"][:, 5], rows["pose"][:, 6] = np.sin(half), np.cos(half)
    return PackedMessage(Path(header=Header(0, stamp, frame)), len(poses), rows.tobytes())


def polygon(vertices: np.ndarray, frame: str, stamp: Any) -> PolygonStamped:
    """Return vertices (n, 2) [m] as a geometry_msgs/PolygonStamped."""
    message = PolygonStamped(header=Header(0, stamp, frame))
    message.polygon.points = [Point32(float(x), float(y), 0.0) for x, y in vertices]
    return message


def cloud(rows: np.ndarray, names: Sequence[str], frame: str, stamp: Any) -> PointCloud2:
    """Return rows (n, len(names)) as a sensor_msgs/PointCloud2 of FLOAT32 fields."""
    message = PointCloud2(header=Header(0, stamp, frame), height=1, width=len(rows), is_dense=True)
    message.fields = [
        PointField(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate(names)
    ]
    message.point_step = 4 * len(names)
    message.row_step = message.point_step * len(rows)
    message.data = np.ascontiguousarray(rows, dtype="<f4").tobytes()
    return message
