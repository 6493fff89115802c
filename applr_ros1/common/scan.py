"""Sensor readings, their projection into a costmap's frame, and sources of an obstacle layer.

This module alone knows what a range means: measured_ranges() reads what a driver publishes, and
distances_of() tells what a beam has shown. Costmaps take the ranges themselves, by the rules of C++
(project). Costmaps in the same frame share one projection, which rounds like laser_geometry and
tf2. Observation sources follow costmap_2d/observation_buffer.cpp.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, List, Optional, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, Quaternion, compose, transform_point
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel

LEAST_LEVEL_COS = 0.95  # smallest cosine of the tilt of a level laser; 18 degrees
# Angle from which on a gap between two returns is the open, if the driver has a value of its own
# for no return [rad]. A narrower one may be a dark surface.
OPEN_RAD = math.pi / 2
SHARED_S = 1.0  # time for which the latest cloud of another sensor on the same topic is kept [s]
Point3D = Tuple[float, float, float]
RangeLimits = Tuple[np.float32, np.float32]


@dataclass
class LaserScan:
    """One scan of a planar laser. Angles are in rad.

    Attributes:
        stamp: Time of the scan [s].
        ranges: (n,) float32 [m] as in the message, but +inf for no return. All but the costmaps
            use `distances` and `free`.
        sensor_pose: (x, y, yaw) of the laser in the costmap's frame at `stamp` [m, m, rad].
        sensor_height: z of the laser [m].
        rotation: Orientation (x, y, z, w) of a tilted or inverted laser, used instead of the yaw in
            sensor_pose.
        origin: Start of the rays [m] if it differs from the laser's position (the parameter
            sensor_frame).
        sweep: Time from the first beam to the last [s], 0 if all are measured at once.
        frame: Frame of the laser, by which several lasers on one topic are told apart.
        no_return: Range that the driver publishes for no return (Laser of robot.yaml), None if
            there is none.
    """

    stamp: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: Array32
    sensor_pose: Pose
    sensor_height: float = 0.0
    rotation: Optional[Quaternion] = None
    origin: Optional[Point3D] = None
    sweep: float = 0.0
    frame: str = ""
    no_return: Optional[float] = None

    @cached_property
    def distances(self) -> Array32:
        """What each beam has shown (n,) [m], as distances_of() returns it."""
        if self.no_return is None:
            return self._returns
        # What a narrow gap hides is unknown.
        return np.where(self.free < self._returns, np.float32(np.nan), self._returns)

    @cached_property
    def free(self) -> Array32:
        """Distance up to which each beam is free (n,) [m]; else as `distances`."""
        if self.no_return is None:
            return self._returns
        return _free_as_beside(self._returns, self.angle_increment)

    @cached_property
    def _returns(self) -> Array32:
        """What each beam has shown (n,) [m] if no return is a free beam everywhere."""
        return distances_of(self.ranges, self.range_min, self.range_max)

    def placed(self, sensor_pose: Pose) -> LaserScan:
        """Return the scan with another pose of the laser, on which no distance depends."""
        placed_scan = copy(self)
        placed_scan.sensor_pose = sensor_pose
        return placed_scan


@dataclass
class SensorCloud:
    """Point cloud in the frame of a sensor.

    Attributes:
        stamp: Time of the measurement [s].
        points: (n, 3) float32 [m].
        position: (x, y, z) of the sensor in the costmap's frame [m].
        rotation: Orientation (x, y, z, w) of the sensor in the costmap's frame.
        origin, frame: As in LaserScan.
    """

    stamp: float
    points: Array32
    position: Point3D
    rotation: Quaternion
    origin: Optional[Point3D] = None
    frame: str = ""


@dataclass
class PointCloud:
    """Points (n, 3) float32 [m] in the costmap's frame.

    They were measured by the sensor `frame` at `stamp` [s]. The rays start at `origin` (x, y, z)
    [m].
    """

    origin: Point3D
    points: Array32
    stamp: float = 0.0
    frame: str = ""


Observation = Union[LaserScan, SensorCloud]


def measured_ranges(ranges: Any, no_return: Optional[float]) -> Array32:
    """Return a copy of the ranges (n,) [m] of a laser in float32, +inf for no return.

    Args:
        ranges: Ranges as the driver publishes them.
        no_return: Range that the driver publishes for no return besides +inf (Laser of
            robot.yaml); None if there is none.
    """
    measured = np.array(ranges, dtype=np.float32)
    if no_return is not None:
        measured[measured == np.float32(no_return)] = np.inf
    return measured


def distances_of(ranges: Any, range_min: float, range_max: float) -> Array32:
    """Return what the beams of a laser have shown (n,) float32 [m].

    A finite distance was measured. +inf: the beam is free up to range_max. -inf: something is
    nearer than range_min. NaN: nothing is known (REP 117; older drivers publish 0).

    Args:
        ranges: (n,) measured_ranges().
        range_min: Smallest range that the laser measures [m].
        range_max: Range from which on a beam has no return [m].
    """
    distances = np.array(ranges, dtype=np.float32)
    distances[distances == 0.0] = np.nan
    # Limits of double precision, because no float32 holds some drivers' range_max.
    distances[distances < np.float64(range_min)] = -np.inf
    distances[distances >= np.float64(range_max)] = np.inf
    return distances


def _free_as_beside(distances: Array32, increment: float) -> Array32:
    """Return the distances (n,) [m], but for no return the smaller of the returns on both sides.

    A driver with a value of its own for no return sends it for dark and glossy surfaces as well.
    In a gap of OPEN_RAD or more, no return is the open.
    """
    beam_count = len(distances)
    returns = np.flatnonzero(np.isfinite(distances))
    # Beams and distances at the edges of all gaps. The ends of a fan are open.
    edges = np.concatenate([[-1], returns, [beam_count]])
    bounds = np.concatenate([[np.inf], distances[returns], [np.inf]])
    if len(returns) and covers_full_turn(beam_count, increment):
        edges[[0, -1]] = returns[-1] - beam_count, returns[0] + beam_count
        bounds[[0, -1]] = bounds[[-2, 1]]

    gaps = np.flatnonzero(np.isposinf(distances))
    last = np.searchsorted(edges, gaps)
    is_narrow = (edges[last] - edges[last - 1]) * abs(increment) < OPEN_RAD
    nearer = np.minimum(bounds[last], bounds[last - 1])
    free = distances.copy()
    free[gaps] = np.where(is_narrow, nearer, np.inf)
    return free


@kernel
def covers_full_turn(count: int, increment: float) -> bool:
    """Return whether `count` beams that are `increment` [rad] apart cover a full turn."""
    return (count + 0.5) * abs(increment) >= 2.0 * math.pi


def observe(observation: Observation, inf_is_valid: bool = False) -> PointCloud:
    """Return the PointCloud of an observation. inf_is_valid applies to laser scans only."""
    if isinstance(observation, SensorCloud):
        cloud = place_cloud(observation)
    else:
        cloud = project(observation, inf_is_valid)
    cloud.frame = observation.frame
    return cloud


def moved(observation: Observation, frame: Pose) -> Observation:
    """Transform an observation from the frame at the pose `frame` to that pose's parent frame."""
    if isinstance(observation, LaserScan):
        observation = observation.placed(compose(frame, observation.sensor_pose))
    else:
        x, y, z = observation.position
        observation = replace(observation, position=(*transform_point(frame, x, y), z))
    if observation.origin is not None:
        x, y, z = observation.origin
        observation.origin = (*transform_point(frame, x, y), z)
    # A level laser has none.
    if observation.rotation is not None:
        observation.rotation = _turned(observation.rotation, frame[2])
    return observation


def _turned(q: Quaternion, yaw: float) -> Quaternion:
    """Return the unit quaternion q (x, y, z, w) followed by a rotation about z by yaw [rad]."""
    sine = math.sin(0.5 * yaw)
    cosine = math.cos(0.5 * yaw)
    x, y, z, w = q
    return (
        cosine * x - sine * y,
        cosine * y + sine * x,
        cosine * z + sine * w,
        cosine * w - sine * z,
    )


def from_above(ranges: Array32, first_angle: float, increment: float) -> Tuple[Array32, float]:
    """Return (ranges, first angle [rad]) of a laser upside down as seen from above.

    Left and right are exchanged, so that the last beam becomes the first.
    """
    last_angle = first_angle + increment * (len(ranges) - 1)
    return ranges[::-1], -last_angle


@lru_cache(maxsize=8)
def beam_directions(angle_min: float, angle_increment: float, count: int) -> Array:
    """Return cosine and sine (count, 2) of every beam. Tables of recent geometries are cached."""
    # The messages of ROS have float32 angles, from which laser_geometry computes in double.
    first_angle = float(np.float32(angle_min))
    angle_step = float(np.float32(angle_increment))
    directions = np.empty((count, 2))
    for beam in range(count):
        angle = first_angle + beam * angle_step
        # numpy's vectorised cosine may differ from the C library's in the last bit.
        directions[beam, 0] = math.cos(angle)
        directions[beam, 1] = math.sin(angle)
    return directions


def project(scan: LaserScan, inf_is_valid: bool = False) -> PointCloud:
    """Return the PointCloud of a LaserScan (docs/explanation/planner.md, section 3.1).

    Beams with range_min <= range < range_max are kept. With `inf_is_valid`, +inf becomes a hit just
    short of range_max and therefore clears. NaN and -inf are always dropped.
    """
    ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
    directions = beam_directions(float(scan.angle_min), float(scan.angle_increment), len(ranges))
    points = np.empty((len(ranges), 3), np.float32)
    x, y, yaw = map(float, scan.sensor_pose)
    position = x, y, float(scan.sensor_height)
    bounds = np.float32(scan.range_min), np.float32(scan.range_max)
    inf_is_valid = bool(inf_is_valid)

    # The points of a tilted laser are computed in its own frame, and then placed like a cloud.
    if scan.rotation is not None:
        point_count = _project(
            ranges, directions, bounds, inf_is_valid, (0.0, 0.0, 0.0), 0.0, points
        )
        points_in_laser = points[:point_count]
        return place_cloud(
            SensorCloud(scan.stamp, points_in_laser, position, scan.rotation, scan.origin)
        )

    point_count = _project(ranges, directions, bounds, inf_is_valid, position, yaw, points)
    return PointCloud(scan.origin or position, points[:point_count], scan.stamp)


def place_cloud(cloud: SensorCloud) -> PointCloud:
    """Return the finite points of a SensorCloud in the costmap's frame.

    They are computed in float32 like doTransform of tf2_sensor_msgs.
    """
    points = np.array(cloud.points, dtype=np.float32).reshape(-1, 3)
    # Most predictions have no points.
    if len(points):
        points = points[np.isfinite(points).all(axis=1)]
        placement = np.array(cloud.rotation + cloud.position, dtype=np.float32)
        _place(points, *placement)
    x, y, z = cloud.origin or cloud.position
    return PointCloud((float(x), float(y), float(z)), points, cloud.stamp)


@kernel
def _place(
    points: Array32, qx: float, qy: float, qz: float, qw: float, tx: float, ty: float, tz: float
) -> None:
    """Rotate by (qx, qy, qz, qw) and translate by (tx, ty, tz) the points (n, 3) float32 in place.

    Every step is rounded to float32, in the order of Eigen's toRotationMatrix.
    """
    # Python's numbers are double, which would make double of every product.
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
    for point in range(points.shape[0]):
        x = points[point, 0]
        y = points[point, 1]
        z = points[point, 2]
        points[point, 0] = (((one - (yy + zz)) * x + (xy - zw) * y) + (xz + yw) * z) + tx
        points[point, 1] = (((xy + zw) * x + (one - (xx + zz)) * y) + (yz - xw) * z) + ty
        points[point, 2] = (((xz - yw) * x + (yz + xw) * y) + (one - (xx + yy)) * z) + tz


@kernel
def _project(
    ranges: Array32,
    directions: Array,
    bounds: RangeLimits,
    inf_is_valid: bool,
    origin: Point3D,
    yaw: float,
    points: Array32,
) -> int:
    """Write the points of a scan in the costmap's frame to `points` (n, 3) float32.

    Args:
        ranges: Ranges (n,) [m].
        directions: Cosine and sine (n, 2) of the beams.
        bounds: Smallest and largest range [m].
        inf_is_valid: Whether +inf becomes a hit just short of the largest range.
        origin: Position (x, y, z) of the laser [m].
        yaw: Yaw of the laser [rad].
        points: Receives the points.

    Returns:
        The number of points, as some beams give none.
    """
    range_min, range_max = bounds
    x, y, z = origin
    one = np.float32(1.0)
    two = np.float32(2.0)
    # Rotation matrix of the quaternion (0, 0, qz, qw), computed in float32 like doTransform of tf2.
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
    # observation_buffer replaces +inf by a range that still counts as valid, see costmap_2d's
    # laserScanValidInfCallback (epsilon).
    almost_max = range_max - np.float32(0.0001)
    point_count = 0
    for beam in range(ranges.shape[0]):
        distance = ranges[beam]
        if inf_is_valid and distance == np.inf:
            distance = almost_max
        if distance >= range_min and distance < range_max:
            # laser_geometry multiplies in double and stores float32.
            point_x = np.float32(np.float64(distance) * directions[beam, 0])
            point_y = np.float32(np.float64(distance) * directions[beam, 1])
            points[point_count, 0] = (m00 * point_x + m01 * point_y) + tx
            points[point_count, 1] = (m10 * point_x + m00 * point_y) + ty
            points[point_count, 2] = tz
            point_count += 1
    return point_count


@dataclass
class Source:
    """Settings of one observation source, named like the ROS parameters.

    The defaults suit a planar laser.
    """

    topic: str = "scan"
    data_type: str = "LaserScan"  # message type: LaserScan, PointCloud2 or PointCloud
    sensor_frame: str = ""  # frame at whose origin the rays start; empty: the frame of the message
    marking: bool = True
    clearing: bool = True
    inf_is_valid: bool = False  # whether +inf of a laser scan clears up to the maximum range
    min_obstacle_height: float = -2.0  # height below which points are dropped [m]
    max_obstacle_height: float = 2.0  # height above which points are dropped [m]
    obstacle_range: float = 2.5  # range below which points mark [m]
    raytrace_range: float = 3.0  # range up to which rays clear [m]
    observation_persistence: float = 0.0  # time for which clouds are kept [s]; 0: the latest only
    # longest time between messages if the source is current [s]; 0: any
    expected_update_rate: float = 0.0


class ObservationBuffer:
    """Point clouds of one observation source. Every update of the costmap applies all of them.

    Attributes:
        source: Settings of the source.
        clouds: PointClouds in the costmap's frame, latest first.
        taken: Arrival time of the latest cloud [s], None before the first.
    """

    def __init__(self, source: Source):
        self.source = source
        self.clouds: List[PointCloud] = []
        self.taken: Optional[float] = None

    def add_cloud(self, cloud: PointCloud, now: float) -> None:
        """Add a cloud at time `now` [s], and drop clouds older than observation_persistence.

        With a persistence of 0, the latest cloud of each sensor is kept: several may publish before
        a costmap update.
        """
        self.taken = now
        persistence = self.source.observation_persistence
        if persistence <= 0.0:
            latest_clouds = [cloud]
            for other_cloud in self.clouds:
                if other_cloud.frame != cloud.frame and now - other_cloud.stamp < SHARED_S:
                    latest_clouds.append(other_cloud)
            self.clouds = latest_clouds
            return
        self.clouds.insert(0, cloud)
        # As in purgeStaleObservations of C++, all clouds behind the first old one go, whatever
        # their age.
        for index, kept_cloud in enumerate(self.clouds):
            if now - kept_cloud.stamp > persistence:
                del self.clouds[index:]
                break

    def forget(self) -> None:
        """Drop all clouds, and reset to the state before the first message."""
        self.clouds = []
        self.taken = None

    def is_current(self, now: float) -> bool:
        """Return whether the latest message is no older than expected_update_rate allows."""
        longest_interval = self.source.expected_update_rate
        return longest_interval <= 0.0 or (
            self.taken is not None and now - self.taken <= longest_interval
        )
