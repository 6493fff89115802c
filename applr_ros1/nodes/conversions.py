"""Conversions between ROS messages and arrays, for the nodes.

The functions are pure and do not need rospy. Large messages (maps, plans, clouds) are serialized
from their array in one piece. The generated classes would pack them number by number, which takes
28 ms for a global map.
"""

from __future__ import annotations

import math
import os
import struct
from typing import Any, Container, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Point32,
    Polygon,
    PolygonStamped,
    PoseStamped,
    Quaternion,
    Vector3,
)
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import Twist as TwistMessage
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import MapMetaData, OccupancyGrid, Path
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from applr_ros1.common.angles import Pose, Twist, quaternion_of, yaw_of
from applr_ros1.common.arrays import Array, Array32, Data
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.messages import pose_of, twist_of
from applr_ros1.common.scan import (
    LaserScan,
    Point3D,
    SensorCloud,
    from_above,
    measured_ranges,
)
from applr_ros1.planner.costmap.static_layer import StaticMap

# Names of the states of a goal by their number, such as {3: "succeeded"}.
GOAL_STATES = {number: name.lower() for name, number in vars(GoalStatus).items() if name.isupper()}
LEVEL_COS = 1.0 - 2e-6  # smallest cosine of the tilt of a level sensor

# Occupancy by costmap value c: 0 for free cells, 1 + 97 (c - 1) / 251 up to 252, 99 for inscribed,
# 100 for lethal and -1 for unknown cells (costmap_2d_publisher.cpp).
_RAISED = 1 + 97 * np.arange(252) // 251
OCCUPANCY = np.concatenate(([0], _RAISED, [99, 100, -1])).astype(np.int8)
# Fields of cost_cloud, a point per cell, and of trajectory_cloud, a point per pose of a sample.
COST_FIELDS = ("x", "y", "z", "path_cost", "goal_cost", "occ_cost", "total_cost")
TRAJECTORY_FIELDS = ("x", "y", "z", "theta", "cost")


class MessageError(ApplrError):
    """A message that cannot be used. The text gives the reason in one line."""


def goal_in(message: GoalStatusArray, states: Container[int]) -> Optional[str]:
    """Return the id of the goal that is in one of these states of GoalStatus, None without one.

    The last of several is the one that is driven to.
    """
    goal_id = None
    for goal_status in message.status_list:
        if goal_status.status in states:
            goal_id = goal_status.goal_id.id
    return goal_id


def is_upright(q: Any) -> bool:
    """Return whether a quaternion is finite, nonzero, and rotates about z only.

    The tolerances are those of isQuaternionValid in move_base.cpp.
    """
    squared_length = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not math.isfinite(squared_length) or squared_length < 1e-6:
        return False
    tilt = 2.0 * (q.x * q.x + q.y * q.y) / squared_length  # 1 - cosine of the z axis's tilt
    return bool(tilt <= 1e-3)


def path_points(stamped_poses: Sequence[PoseStamped]) -> Array:
    """Return the points (n, 2) [m] of poses in the order of a nav_msgs/Path."""
    points = []
    for stamped_pose in stamped_poses:
        position = stamped_pose.pose.position
        points.append((position.x, position.y))
    return np.array(points).reshape(-1, 2)


class Reading(NamedTuple):
    """Pose and velocity of a robot by odometry, or by the simulator.

    Attributes:
        time: Stamp [s].
        pose: x, y [m], yaw [rad].
        twist: v [m/s], w [rad/s].
    """

    time: float
    pose: Pose
    twist: Twist


def reading_of(message: Any) -> Reading:
    """Convert a nav_msgs/Odometry."""
    return Reading(
        time=message.header.stamp.to_sec(),
        pose=pose_of(message.pose.pose),
        twist=twist_of(message.twist.twist),
    )


def pose_stamped(pose: Pose, frame: str, stamp: Any) -> PoseStamped:
    """Return a geometry_msgs/PoseStamped of the pose (x, y, yaw) [m, m, rad] in `frame`."""
    x, y, yaw = pose
    planar_pose = PoseMessage(Point(x, y, 0.0), Quaternion(*quaternion_of(yaw)))
    return PoseStamped(Header(0, stamp, frame), planar_pose)


def twist(v: float, w: float) -> TwistMessage:
    """Return a geometry_msgs/Twist of a forward speed v [m/s] and a turn rate w [rad/s]."""
    return TwistMessage(Vector3(v, 0.0, 0.0), Vector3(0.0, 0.0, w))


def diagnostics(
    name: str, level: int, text: str, values: Mapping[str, Any], stamp: Any
) -> DiagnosticArray:
    """Return a diagnostic_msgs/DiagnosticArray with one status and its {key: value} pairs."""
    key_values = []
    for key, value in values.items():
        value_text = f"{value:.3f}" if isinstance(value, float) else str(value)
        key_values.append(KeyValue(key, value_text))
    status = DiagnosticStatus(level, name, text, "none", key_values)
    return DiagnosticArray(Header(0, stamp, ""), [status])


# -- from messages ---------------------------------------------------------------------------------
def check_scan(message: Any, no_return: Optional[float] = None) -> Array32:
    """Return the ranges (n,) float32 of a sensor_msgs/LaserScan.

    The range `no_return` becomes +inf. Beams of NaN, inf and -inf are valid (REP 117), but if all
    are NaN, the scanner is blind.

    Raises:
        MessageError: The scan cannot be used.
    """
    if not len(message.ranges):
        raise MessageError("has 0 beams")

    # laser_geometry accepts an infinite range_max, too.
    geometry = (message.angle_min, message.angle_increment, message.range_min, message.range_max)
    are_numbers = all(map(math.isfinite, geometry[:3])) and not math.isnan(message.range_max)
    if not are_numbers or message.angle_increment == 0.0:
        problem = f"has angle_min, angle_increment, range_min, range_max = {geometry}"
        raise MessageError(f"{problem}: give finite numbers and an increment")

    ranges = measured_ranges(message.ranges, no_return)
    if np.isnan(ranges).all():
        raise MessageError("is all NaN: check the scanner")
    return ranges


def points_of(message: Any) -> Array32:
    """Return the points (n, 3) float32 of a sensor_msgs/PointCloud2 or PointCloud.

    Raises:
        MessageError: A field is missing.
        ValueError: The sizes are inconsistent.
        TypeError: A size is no number.
    """
    if hasattr(message, "points"):
        points = [(point.x, point.y, point.z) for point in message.points]
        return np.array(points, np.float32).reshape(-1, 3)
    if message.width * message.height == 0:
        return np.zeros((0, 3), np.float32)

    # A driver may put the fields in any order, and others between them.
    offsets = {}
    for field in message.fields:
        if field.datatype == PointField.FLOAT32:
            offsets[field.name] = field.offset
    if not {"x", "y", "z"} <= set(offsets):
        problem = _described_fields(message)
        raise MessageError(f"{problem}: give x, y and z as FLOAT32")
    float_format = ">f4" if message.is_bigendian else "<f4"
    point_layout = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [float_format] * 3,
            "offsets": [offsets["x"], offsets["y"], offsets["z"]],
            "itemsize": message.point_step,
        }
    )

    # Many drivers leave row_step 0 in clouds of one row.
    row_step = message.row_step
    if message.height == 1:
        row_step = message.width * message.point_step
    grid_points = np.ndarray(
        shape=(message.height, message.width),
        dtype=point_layout,
        buffer=message.data,
        strides=(row_step, message.point_step),
    )
    columns = [grid_points[axis].ravel() for axis in "xyz"]
    return np.stack(columns, axis=1).astype(np.float32)


def _described_fields(cloud: Any) -> str:
    """Return the fields of a sensor_msgs/PointCloud2 in words."""
    descriptions = [f"{field.name} (datatype {field.datatype})" for field in cloud.fields]
    if not descriptions:
        return "has no fields"
    return f"has the fields {', '.join(descriptions)}"


def point_of(transform: Any) -> Point3D:
    """Return the translation (x, y, z) of a geometry_msgs/Transform."""
    return transform.translation.x, transform.translation.y, transform.translation.z


def _rotation(transform: Any) -> Tuple[float, float, float, float]:
    q = transform.rotation
    return q.x, q.y, q.z, q.w


def cos_tilt(quaternion: Tuple[float, float, float, float]) -> float:
    """Return the cosine of the angle by which a rotation (x, y, z, w) tilts the z axis."""
    x, y, _, _ = quaternion
    return 1.0 - 2.0 * (x**2 + y**2)


def laser_scan(
    message: Any,
    ranges: Array32,
    transform: Any,
    origin: Optional[Point3D] = None,
    no_return: Optional[float] = None,
) -> LaserScan:
    """Convert a message whose ranges have been checked to the planner's scan.

    Args:
        message: sensor_msgs/LaserScan.
        ranges: (n,) float32 its ranges [m].
        transform: geometry_msgs/Transform of the laser in the costmap's frame.
        origin: Start of the rays if it is not the laser.
        no_return: Range that the driver publishes for no return.
    """
    # A level laser needs no rotation: the planner computes with its pose alone, which is faster.
    quaternion = _rotation(transform)
    tilt_cosine = cos_tilt(quaternion)
    rotation = None if abs(tilt_cosine) > LEVEL_COS else quaternion
    hangs = tilt_cosine < -LEVEL_COS
    first_angle = message.angle_min
    if hangs:
        ranges, first_angle = from_above(ranges, first_angle, message.angle_increment)
    beam_intervals = len(ranges) - 1
    return LaserScan(
        message.header.stamp.to_sec(),
        first_angle,
        message.angle_increment,
        message.range_min,
        message.range_max,
        ranges,
        pose_of(transform),
        transform.translation.z,
        rotation=rotation,
        origin=origin,
        sweep=abs(message.time_increment) * beam_intervals,
        frame=message.header.frame_id,
        no_return=no_return,
    )


def sensor_cloud(message: Any, transform: Any, origin: Optional[Point3D] = None) -> SensorCloud:
    """Convert a sensor_msgs/PointCloud2 or PointCloud to the planner's cloud.

    Arguments and errors are those of laser_scan and points_of.
    """
    return SensorCloud(
        message.header.stamp.to_sec(),
        points_of(message),
        point_of(transform),
        _rotation(transform),
        origin,
        message.header.frame_id,
    )


def static_map(message: Any) -> StaticMap:
    """Convert a nav_msgs/OccupancyGrid to the planner's map.

    Raises:
        MessageError: The map is inconsistent or rotated.
    """
    info = message.info
    cell_count = len(message.data)
    if info.width * info.height != cell_count or cell_count == 0:
        raise MessageError(f"has {cell_count} cells for {info.width} x {info.height}")
    orientation = info.origin.orientation  # Some publishers leave it all zero.
    yaw = yaw_of(orientation) if is_upright(orientation) else 0.0
    if abs(yaw) > 1e-3:
        problem = f"has an origin with a yaw of {yaw:.3g} rad"
        raise MessageError(f"{problem}: give an origin without yaw")
    cells = np.array(message.data, dtype=np.int8).reshape(info.height, info.width)
    origin = (float(info.origin.position.x), float(info.origin.position.y))
    frame = message.header.frame_id.lstrip("/")
    return StaticMap(cells, float(info.resolution), origin, frame)


# -- to messages -----------------------------------------------------------------------------------
class PackedMessage:
    """Message whose last field is an array, which is sent in one piece.

    Args:
        message: Generated message, whose array is empty.
        count: Number of elements of the array.
        payload: Elements as bytes.
    """

    _has_header = True  # rospy then numbers the messages, as for a generated class.

    def __init__(self, message: Any, count: int, payload: bytes):
        self.message = message
        self.count = count
        self.payload = payload
        # rospy reads these two attributes of a message.
        self.header = message.header
        self._md5sum = message._md5sum

    def serialize(self, buff: Any) -> None:
        """Write the generated message, then replace the empty array at its end."""
        self.message.serialize(buff)
        buff.seek(-4, os.SEEK_CUR)  # length of the empty array
        buff.write(struct.pack("<I", self.count))
        buff.write(self.payload)


def grid(costmap: Any, frame: str, stamp: Any) -> PackedMessage:
    """Return the whole costmap as a nav_msgs/OccupancyGrid."""
    origin_x, origin_y = map(float, costmap.origin)
    corner = pose_stamped((origin_x, origin_y, 0.0), frame, stamp).pose
    info = MapMetaData(stamp, costmap.resolution, *costmap.size, corner)
    message = OccupancyGrid(Header(0, stamp, frame), info, [])
    occupancy = OCCUPANCY[costmap.cells]
    return PackedMessage(message, occupancy.size, occupancy.tobytes())


def grid_update(cells: Data, corner: Tuple[int, int], frame: str, stamp: Any) -> PackedMessage:
    """Return a window of a costmap's cells (h, w) as a map_msgs/OccupancyGridUpdate.

    corner: its first cell (x, y).
    """
    message = OccupancyGridUpdate(header=Header(0, stamp, frame))
    message.x, message.y = corner
    message.height, message.width = cells.shape
    occupancy = OCCUPANCY[cells]
    return PackedMessage(message, occupancy.size, occupancy.tobytes())


def path(poses: Array, frame: str, stamp: Any) -> PackedMessage:
    """Return poses (n, 3) x, y, yaw, or points (n, 2) without rotation, as a nav_msgs/Path."""
    # A row has the layout of a serialized geometry_msgs/PoseStamped.
    frame_name = frame.encode()
    field_length = max(1, len(frame_name))  # numpy has no texts of length 0.
    row_layout = [("header", "<u4", 4), ("frame", f"S{field_length}"), ("pose", "<f8", 7)]
    rows = np.zeros(len(poses), row_layout)
    rows["header"] = (0, stamp.secs, stamp.nsecs, len(frame_name))
    rows["frame"] = frame_name

    # x, y, z, and the quaternion x, y, z, w of a rotation about z
    half_yaw = np.zeros(len(poses))
    if poses.shape[1] > 2:
        half_yaw = 0.5 * poses[:, 2]
    rows["pose"][:, :2] = poses[:, :2]
    rows["pose"][:, 5] = np.sin(half_yaw)
    rows["pose"][:, 6] = np.cos(half_yaw)
    message = Path(header=Header(0, stamp, frame))
    return PackedMessage(message, len(poses), rows.tobytes())


def polygon(vertices: Array, frame: str, stamp: Any) -> PolygonStamped:
    """Return vertices (n, 2) [m] as a geometry_msgs/PolygonStamped."""
    points = [Point32(float(x), float(y), 0.0) for x, y in vertices]
    return PolygonStamped(Header(0, stamp, frame), Polygon(points))


def cloud(rows: Data, names: Sequence[str], frame: str, stamp: Any) -> PointCloud2:
    """Return rows (n, len(names)) as a sensor_msgs/PointCloud2 of FLOAT32 fields."""
    message = PointCloud2(header=Header(0, stamp, frame), height=1, width=len(rows), is_dense=True)
    for index, field_name in enumerate(names):
        message.fields.append(PointField(field_name, 4 * index, PointField.FLOAT32, 1))
    message.point_step = 4 * len(names)
    message.row_step = message.point_step * len(rows)
    message.data = np.ascontiguousarray(rows, dtype="<f4").tobytes()
    return message
