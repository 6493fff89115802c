"""Tracker of moving obstacles: from scans and odometry to discs with velocities.

docs/explanation/movers.md describes method, limits and accuracy of the tracker.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, normalize_angle, transform_motions
from applr_ros1.common.arrays import Array32
from applr_ros1.common.scan import LaserScan, beam_directions
from applr_ros1.movers import clusters, tracks
from applr_ros1.movers.free_space import FAN, SCANS, FreeSpace, depths
from applr_ros1.robots import Robot

PAUSE_S = 1.0  # forward gap or backward step between stamps that counts as a time jump [s]
# A pose change faster than this multiple of the maximum speed counts as a jump.
FASTER_FACTOR = 1.5
# Additional pose change that corrections of the odometry may cause.
SHIFT_M = 0.3
TURN_RAD = 0.3
# Columns of the moving obstacles
DISC_COLUMNS = ("x", "y", "vx", "vy", "pp", "pv", "vv", "certain", "radius")
SMOOTH_S = 0.1  # time constant of the low-pass filter on speed and turn rate [s]


class Movers(NamedTuple):
    """Moving obstacles in the odometry's frame at a scan's stamp, as arrays of equal length.

    id: persistent ID (int64). x, y: centre of the disc [m]. vx, vy: velocity [m/s]. radius: radius
    of the disc [m]. covariance: (n, 3) variance of the position [m^2], covariance of position and
    velocity [m^2/s], and variance of the velocity [m^2/s^2], along each axis. is_certain: whether
    the velocity is, or was, certain enough to act on.
    """

    id: np.ndarray
    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    radius: np.ndarray
    covariance: np.ndarray
    is_certain: np.ndarray

    def certain(self) -> Movers:
        """Return those whose velocities are certain."""
        return Movers(*(values[self.is_certain] for values in self))


_NONE = np.empty(0)
_NO_NUMBER = np.empty(0, np.int64)
_NO_COVARIANCE = np.empty((0, 3))
_NO_ANSWER = np.empty(0, np.bool_)
NO_MOVERS = Movers(_NO_NUMBER, _NONE, _NONE, _NONE, _NONE, _NONE, _NO_COVARIANCE, _NO_ANSWER)


class MoverTracker:
    """Tracks moving obstacles from scan to scan.

    Args:
        max_speed: maximum speed of the base [m/s]; a pose that changes much faster restarts the
            tracker.
        max_yaw_rate: maximum turn rate of the base [rad/s].
        period: interval between two scans [s]. A laser that measures beam by beam takes this long
            for one scan, even if its driver reports less.

    Attributes:
        frame: Pose (x, y, yaw) [m, m, rad] of the odometry's frame in that of the tracks. Who knows
            how the wheels have slipped so far sets it before a scan, so that what stands does not
            seem to move.
        movers: Moving obstacles at the latest scan's stamp.
    """

    def __init__(self, max_speed: float, max_yaw_rate: float, period: float):
        self.max_speed = float(max_speed)
        self.max_yaw_rate = float(max_yaw_rate)
        self.period = float(period)
        self.frame: Pose = (0.0, 0.0, 0.0)
        self._tracks = np.zeros(tracks.MAX_TRACKS, tracks.TRACK)
        # Points (x, y) [m] of each track in the latest SCANS scans, NaN where there is none.
        self._history = np.empty((SCANS, tracks.MAX_TRACKS, clusters.POINTS, 2))
        self._clusters = np.zeros(clusters.MAX_CLUSTERS, clusters.CLUSTER)
        self._free = FreeSpace()
        self._next_id = 1
        self.reset()

    @classmethod
    def of(cls, robot: Robot) -> MoverTracker:
        """Return a tracker for a robot's base and laser."""
        return cls(robot.base.max_speed, robot.base.max_yaw_rate, 1.0 / robot.laser.rate)

    def reset(self) -> None:
        """Forget all tracks.

        Call it when time or odometry jumps, although update() detects most jumps.
        """
        self._tracks["id"] = 0
        self._tracks["moves"] = False
        self.movers = NO_MOVERS
        self._history[:] = math.nan
        self._free.clear()
        self._last: Optional[Tuple[float, Pose]] = None  # stamp and pose of the last scan
        # Correction of poses in the frame of the tracks, from static tracks.
        self._correction: Pose = (0.0, 0.0, 0.0)
        self._to_odometry: Pose = (0.0, 0.0, 0.0)
        # Filtered turn rate [rad/s] and speed [m/s], from odometry.
        self._turn_rate = 0.0
        self._speed = 0.0
        # Magnitudes of the turn rate over the last two scan intervals [rad/s].
        self._rates = (0.0, 0.0)

    def update(self, scan: LaserScan) -> Movers:
        """Update the tracks with a scan.

        The scan's sensor_pose is the laser's pose in the odometry's frame at its stamp. A scan is
        ignored if it is not newer than the last one, or if its laser is tilted. The tracker
        restarts if time jumps, or if the pose changes faster than the base can drive.

        Returns:
            The moving obstacles at the latest scan's stamp, empty if there are none.
        """
        x, y, yaw = map(float, compose(self.frame, scan.sensor_pose))
        interval = 0.0
        distance = 0.0
        turn_angle = 0.0
        if self._last is not None:
            last_stamp, (last_x, last_y, last_yaw) = self._last
            interval = scan.stamp - last_stamp
            if -PAUSE_S < interval <= 0.0:
                return self.movers
            distance = math.hypot(x - last_x, y - last_y)
            turn_angle = normalize_angle(yaw - last_yaw)
            if self._has_jumped(interval, distance, turn_angle):
                self.reset()
                interval = 0.0
        if scan.rotation is not None:
            return self.movers
        if self._last is not None:
            self._filter_speeds(interval, distance, turn_angle)
        self._last = scan.stamp, (x, y, yaw)
        self._follow(scan, (x, y, yaw), interval)
        self.movers = self._moving()
        return self.movers

    def _has_jumped(self, interval: float, distance: float, turn_angle: float) -> bool:
        """Return whether time has jumped, or the pose faster than the base can drive and turn."""
        farthest = FASTER_FACTOR * self.max_speed * interval + SHIFT_M
        largest_turn = FASTER_FACTOR * self.max_yaw_rate * interval + TURN_RAD
        return abs(interval) > PAUSE_S or distance > farthest or abs(turn_angle) > largest_turn

    def _filter_speeds(self, interval: float, distance: float, turn_angle: float) -> None:
        turn_rate = turn_angle / interval
        gain = 1.0 - math.exp(-interval / SMOOTH_S)
        self._rates = self._rates[1], abs(turn_rate)
        self._turn_rate += gain * (turn_rate - self._turn_rate)
        self._speed += gain * (distance / interval - self._speed)

    def _follow(self, scan: LaserScan, pose: Pose, interval: float) -> None:
        """Update the tracks with a scan after `interval` [s], and the correction of its pose."""
        ranges = scan.distances
        fans = self._fans(scan, pose)
        depth = depths(ranges, float(scan.range_max))
        scan_clusters = self._find_clusters(scan, ranges, fans)
        cluster_of, is_taken = tracks.follow(
            self._tracks,
            self._history,
            scan_clusters,
            depth,
            fans,
            tracks.EarlierScans(self._free.ranges, self._free.fans),
            interval,
            self._speed,
        )
        fan = fans[0]
        corrected: Pose = (float(fan["x"]), float(fan["y"]), float(fan["yaw"]))
        self._correction = compose(corrected, inverse(pose))
        self._to_odometry = inverse(compose(self._correction, self.frame))
        self._next_id = tracks.begin(
            self._tracks, scan_clusters, is_taken, scan.stamp, self._next_id
        )
        if self._free.due(scan.stamp):
            self._free.take(depth, fan)
            tracks.remember(self._history, self._free.newest, cluster_of, scan_clusters)

    def _fans(self, scan: LaserScan, pose: Pose) -> np.ndarray:
        """Return the FAN of a scan as array (1,), which the kernels correct in place."""
        # A laser whose beams are measured one after the other sees a turning robot's room bent.
        swept_angle = 0.0
        if scan.sweep > 0.0:
            swept_angle = max(scan.sweep, self.period) * max(self._rates)
        fan = (
            scan.stamp,
            *compose(self._correction, pose),
            scan.angle_min,
            scan.angle_increment,
            scan.range_min,
            scan.range_max,
            len(scan.ranges),
            self._turn_rate,
            swept_angle,
        )
        return np.array([fan], FAN)

    def _find_clusters(self, scan: LaserScan, ranges: Array32, fans: np.ndarray) -> np.ndarray:
        """Return the CLUSTERs (n,) of a scan, in memory that the next scan overwrites."""
        first_angle = float(scan.angle_min)
        increment = float(scan.angle_increment)
        directions = beam_directions(first_angle, increment, len(ranges))
        cluster_count = clusters.find_clusters(ranges, directions, fans, self._clusters)
        return self._clusters[:cluster_count]

    def _moving(self) -> Movers:
        """Return the moving obstacles among the tracks."""
        is_moving = self._tracks["moves"]
        if not is_moving.any():
            return NO_MOVERS
        # The older leg of a person comes first, and keeps its number.
        moving_tracks = np.sort(self._tracks[is_moving], order="id")
        discs = np.column_stack([moving_tracks[column] for column in DISC_COLUMNS])
        tracks.join_legs(discs)
        remains = np.isfinite(discs[:, -1])
        discs = discs[remains]
        x, y, vx, vy = transform_motions(self._to_odometry, discs[:, :4]).T
        return Movers(
            moving_tracks["id"][remains],
            x,
            y,
            vx,
            vy,
            radius=discs[:, -1],
            covariance=discs[:, 4:7],
            is_certain=discs[:, 7] > 0.0,
        )
