"""Readings of sensors, their projection into a costmap's frame, and the observation sources of an obstacle layer.

Called by MoveBase and the obstacle layers: one projection, rounded as laser_geometry and tf2 round it, serves both
costmaps where their frames are one. Sources follow costmap_2d/observation_buffer.cpp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Dict, List, Optional, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, compose, transform_point
from applr_ros1.common.kernels import kernel

SHARED_S = 1.0  # s for which the newest cloud of another sensor on the topic counts
Quaternion = Tuple[float, float, float, float]
Point = Tuple[float, float, float]


@dataclass
class LaserScan:
    """One scan.

    Angles [rad], ranges (n,) float32 [m], +inf = no return; `sensor_pose` (x, y, yaw) is the laser's pose in the
    costmap's frame at `stamp` [s], `sensor_height` its z [m]. rotation: quaternion (x, y, z, w) of a laser that is not
    level or hangs upside down, in place of the yaw. origin: where the rays start [m] if that is not the laser's place
    (the parameter sensor_frame). sweep: time [s] from the first beam to the last, 0 where they are measured at once.
    frame: of the laser; several may publish on one topic.
    """

    stamp: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: np.ndarray
    sensor_pose: Pose
    sensor_height: float = 0.0
    rotation: Optional[Quaternion] = None
    origin: Optional[Point] = None
    sweep: float = 0.0
    frame: str = ""


@dataclass
class SensorCloud:
    """Points (n, 3) float32 [m] in a sensor's frame, seen at `stamp` [s].

    position (x, y, z) [m] and rotation, a quaternion (x, y, z, w), place the sensor in the costmap's frame; origin:
    where the rays start [m] if that is not the sensor's place (the parameter sensor_frame). frame: as in LaserScan.
    """

    stamp: float
    points: np.ndarray
    position: Point
    rotation: Quaternion
    origin: Optional[Point] = None
    frame: str = ""


@dataclass
class PointCloud:
    """Hits in the costmap's frame: `points` (n, 3) float32 [m], seen from `origin` (x, y, z) [m] at `stamp` [s].

    frame: of the sensor.
    """

    origin: Point
    points: np.ndarray
    stamp: float = 0.0
    frame: str = ""


Observation = Union[LaserScan, SensorCloud]


def observe(observation: Observation, inf_is_valid: bool = False) -> PointCloud:
    """The PointCloud of whatever a source says; inf_is_valid counts for laser scans alone."""
    is_cloud = isinstance(observation, SensorCloud)
    cloud = place_cloud(observation) if is_cloud else project(observation, inf_is_valid)  # type: ignore[arg-type]
    cloud.frame = observation.frame
    return cloud


def moved(observation: Observation, frame: Pose) -> Observation:
    """The same observation in the frame in which `frame` (x, y, yaw) is the pose of its present frame."""
    start = observation.origin
    origin = None if start is None else (*transform_point(frame, start[0], start[1]), start[2])
    if isinstance(observation, LaserScan):
        pose = compose(frame, observation.sensor_pose)
        rotation = None if observation.rotation is None else _turned(observation.rotation, frame[2])
        return replace(observation, sensor_pose=pose, rotation=rotation, origin=origin)
    x, y, z = observation.position
    return replace(
        observation,
        position=(*transform_point(frame, x, y), z),
        rotation=_turned(observation.rotation, frame[2]),
        origin=origin,
    )


def _turned(q: Quaternion, yaw: float) -> Quaternion:
    """The rotation q followed by a turn about z."""
    s, c = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    x, y, z, w = q
    return c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z


_beams: Dict[Tuple[float, float, int], np.ndarray] = {}


def beam_directions(angle_min, angle_increment, count):
    """Cosine and sine (count, 2) of every beam, kept for the last few scan geometries."""
    key = (angle_min, angle_increment, count)
    table = _beams.get(key)
    if table is None:
        if len(_beams) >= 8:
            _beams.clear()
        first, step = float(np.float32(angle_min)), float(np.float32(angle_increment))
        angles = [first + i * step for i in range(count)]
        table = np.array([[math.cos(a), math.sin(a)] for a in angles], dtype=np.float64).reshape(count, 2)
        _beams[key] = table
    return table


def project(scan: LaserScan, inf_is_valid: bool = False) -> PointCloud:
    """PointCloud of a LaserScan: docs/explanation/planner.md, section 3.1.

    Kept are beams with range_min <= range < range_max. With `inf_is_valid` a +inf counts as a hit just short of
    range_max, so that it clears; NaN and -inf never count.
    """
    ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
    table = beam_directions(float(scan.angle_min), float(scan.angle_increment), len(ranges))
    points = np.empty((len(ranges), 3), np.float32)
    level = scan.rotation is None
    x, y, yaw = scan.sensor_pose if level else (0.0, 0.0, 0.0)
    x, y, z = float(x), float(y), float(scan.sensor_height) if level else 0.0
    count = _project(
        ranges,
        table,
        np.float32(scan.range_min),
        np.float32(scan.range_max),
        bool(inf_is_valid),
        x,
        y,
        z,
        float(yaw),
        points,
    )
    if scan.rotation is not None:
        position = float(scan.sensor_pose[0]), float(scan.sensor_pose[1]), float(scan.sensor_height)
        return place_cloud(SensorCloud(scan.stamp, points[:count], position, scan.rotation, scan.origin))
    return PointCloud((x, y, z) if scan.origin is None else scan.origin, points[:count], scan.stamp)


def place_cloud(cloud: SensorCloud) -> PointCloud:
    """The finite points of a SensorCloud in the costmap's frame, in float32 like tf2_sensor_msgs' doTransform."""
    points = np.array(cloud.points, dtype=np.float32).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    _place(points, *(np.float32(v) for v in cloud.rotation + cloud.position))
    start = cloud.position if cloud.origin is None else cloud.origin
    return PointCloud((float(start[0]), float(start[1]), float(start[2])), points, cloud.stamp)


@kernel
def _place(points, qx, qy, qz, qw, tx, ty, tz):
    """Turn and move the points (n, 3) float32 in place; every step is rounded to float32."""
    one = np.float32(1.0)
    two = np.float32(2.0)
    dx = two * qx
    dy = two * qy
    dz = two * qz
    xw = dx * qw
    yw = dy * qw
    zw = dz * qw
    xx = dx * qx
    xy = dy * qx
    xz = dz * qx
    yy = dy * qy
    yz = dz * qy
    zz = dz * qz
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        points[i, 0] = (((one - (yy + zz)) * x + (xy - zw) * y) + (xz + yw) * z) + tx
        points[i, 1] = (((xy + zw) * x + (one - (xx + zz)) * y) + (yz - xw) * z) + ty
        points[i, 2] = (((xz - yw) * x + (yz + xw) * y) + (one - (xx + yy)) * z) + tz


@kernel
def _project(ranges, table, range_min, range_max, inf_is_valid, x, y, z, yaw, points):
    one = np.float32(1.0)
    two = np.float32(2.0)
    qz = np.float32(math.sin(0.5 * yaw))
    qw = np.float32(math.cos(0.5 * yaw))
    twz = (two * qz) * qw
    tzz = (two * qz) * qz
    m00 = one - tzz
    m01 = -twz
    m10 = twz
    tx = np.float32(x)
    ty = np.float32(y)
    tz = np.float32(z)
    almost_max = range_max - np.float32(0.0001)
    count = 0
    for i in range(ranges.shape[0]):
        r = ranges[i]
        if inf_is_valid and r == np.inf:
            r = almost_max
        if r >= range_min and r < range_max:
            px = np.float32(np.float64(r) * table[i, 0])
            py = np.float32(np.float64(r) * table[i, 1])
            points[count, 0] = (m00 * px + m01 * py) + tx
            points[count, 1] = (m10 * px + m00 * py) + ty
            points[count, 2] = tz
            count += 1
    return count


@dataclass
class Source:
    """Settings of one source, named as the ROS parameters; the defaults are those of a planar laser."""

    topic: str = "scan"
    data_type: str = "LaserScan"  # or PointCloud2, PointCloud
    sensor_frame: str = ""  # where the rays start; empty: the frame of the message
    marking: bool = True
    clearing: bool = True
    inf_is_valid: bool = False  # +inf of a laser scan clears as far as it can
    min_obstacle_height: float = -2.0  # [m] points below or above are dropped
    max_obstacle_height: float = 2.0
    obstacle_range: float = 2.5  # [m] points at or beyond it do not mark
    raytrace_range: float = 3.0  # [m] rays clear up to it
    observation_persistence: float = 0.0  # [s] for which clouds are kept; 0: the newest alone
    expected_update_rate: float = 0.0  # [s] after which the source counts as silent; 0: never

    def __post_init__(self):  # the kernels are compiled for these types alone
        for field in fields(self):
            kind: Any = type(field.default)
            setattr(self, field.name, kind(getattr(self, field.name)))


class ObservationBuffer:
    """The clouds of one source, newest first; they are applied in every update until they go.

    Attributes:
        source: the settings.
        clouds: PointClouds in the costmap's frame.
        taken: time [s] at which the newest one came, None before the first.
    """

    def __init__(self, source: Source):
        self.source = source
        self.clouds: List[PointCloud] = []
        self.taken: Optional[float] = None

    def take(self, cloud: PointCloud, now: float) -> None:
        """A new cloud at time `now` [s]. What was taken longer ago than observation_persistence goes.

        Without persistence the newest of each sensor on the topic stays, for costmaps are updated more rarely.
        """
        self.taken = now
        kept = self.source.observation_persistence
        if kept <= 0.0:
            others = [old for old in self.clouds if old.frame != cloud.frame and now - old.stamp < SHARED_S]
            self.clouds = [cloud, *others]
            return
        self.clouds.insert(0, cloud)
        for i, old in enumerate(self.clouds):
            if now - old.stamp > kept:
                del self.clouds[i:]
                break

    def forget(self) -> None:
        """The source has said nothing yet."""
        self.clouds, self.taken = [], None

    def is_current(self, now: float) -> bool:
        """Return true if messages come as often as expected_update_rate demands."""
        longest = self.source.expected_update_rate
        return longest <= 0.0 or (self.taken is not None and now - self.taken <= longest)
