"""Tracker of moving obstacles: from scans and odometry to discs with velocities.

docs/explanation/movers.md describes method, limits and accuracy of the tracker.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, normalize_angle, transform_point
from applr_ros1.common.scan import LaserScan, beam_directions
from applr_ros1.movers import clusters, tracks
from applr_ros1.movers.free_space import SCANS, FreeSpace, depths
from applr_ros1.robots import Robot

PAUSE_S = 1.0  # forward gap or backward step between stamps that counts as a time jump [s]
FASTER_FACTOR = 1.5  # a pose change faster than this multiple of the maximum speed counts as a jump
SHIFT_M, TURN_RAD = 0.3, 0.3  # additional pose change that odometry corrections may cause [m, rad]
SMOOTH_S = 0.1  # time constant of the low-pass filter on speed and turn rate [s]


class Movers(NamedTuple):
    """Moving obstacles in the odometry's frame at a scan's stamp, as arrays of equal length.

    id: persistent ID (int64). x, y: centre of the disc [m]. vx, vy: velocity [m/s]. radius: radius of the disc [m].
    """

    id: np.ndarray
    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    radius: np.ndarray


class MoverTracker:
    """Tracks moving obstacles from scan to scan.

    Args:
        max_speed: maximum speed of the base [m/s]; a pose that changes much faster restarts the tracker.
        max_yaw_rate: maximum turn rate of the base [rad/s].
        period: interval between two scans [s]. A laser that measures beam by beam takes this long for one scan, even if
            its driver reports less.
    """

    def __init__(self, max_speed: float, max_yaw_rate: float, period: float):
        self.max_speed, self.max_yaw_rate, self.period = (
            float(max_speed),
            float(max_yaw_rate),
            float(period),
        )
        self._tracks = np.zeros((tracks.MAX_TRACKS, tracks.COLUMNS))
        self._history = np.empty((SCANS, tracks.MAX_TRACKS, 6))
        self._clusters = np.empty((clusters.MAX_CLUSTERS, clusters.COLUMNS))
        self._free = FreeSpace()
        self._number = 1
        self.reset()

    @classmethod
    def of(cls, robot: Robot) -> MoverTracker:
        """Return a tracker for a robot's base and laser."""
        return cls(robot.base.max_speed, robot.base.max_yaw_rate, 1.0 / robot.laser.rate)

    def reset(self) -> None:
        """Forget all tracks. Call it when time or odometry jumps, although update() detects most jumps."""
        self._tracks[:] = 0.0
        self._history[:] = math.nan
        self._free.clear()
        self._last: Optional[Tuple[float, Pose]] = None  # stamp and pose of the last scan
        self._correction: Pose = (
            0.0,
            0.0,
            0.0,
        )  # pose correction of the odometry, from static tracks
        self._turning = self._speed = (
            0.0  # filtered turn rate and speed, from odometry [rad/s, m/s]
        )
        self._rates = (
            0.0,
            0.0,
        )  # magnitudes of the turn rate over the last two scan intervals [rad/s]

    def update(self, scan: LaserScan) -> Movers:
        """Update the tracks with a scan whose sensor_pose is the laser's pose in the odometry's frame at its stamp.

        A scan is ignored if it is not newer than the last one, or if its laser is tilted. The tracker restarts if time
        jumps, or if the pose changes faster than the base can drive.

        Returns:
            The moving obstacles at the latest scan's stamp, empty if there are none.
        """
        x, y, yaw = pose = (
            float(scan.sensor_pose[0]),
            float(scan.sensor_pose[1]),
            float(scan.sensor_pose[2]),
        )
        dt = moved = turned = 0.0
        if self._last is not None:
            dt = scan.stamp - self._last[0]
            if -PAUSE_S < dt <= 0.0:
                return self._movers()
            (was_x, was_y, was_yaw) = self._last[1]
            moved, turned = math.hypot(x - was_x, y - was_y), normalize_angle(yaw - was_yaw)
            far = moved > FASTER_FACTOR * self.max_speed * dt + SHIFT_M
            if (
                abs(dt) > PAUSE_S
                or far
                or abs(turned) > FASTER_FACTOR * self.max_yaw_rate * dt + TURN_RAD
            ):
                self.reset()
                dt = 0.0
        if scan.rotation is not None:
            return self._movers()
        if self._last is not None:
            share = 1.0 - math.exp(-dt / SMOOTH_S)
            self._rates = self._rates[1], abs(turned / dt)
            self._turning += share * (turned / dt - self._turning)
            self._speed += share * (moved / dt - self._speed)
        self._last = scan.stamp, pose
        self._follow(scan, pose, dt)
        return self._movers()

    def _follow(self, scan: LaserScan, pose: Pose, dt: float) -> None:
        ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
        n, first, step = len(ranges), float(scan.angle_min), float(scan.angle_increment)
        sensor = compose(self._correction, pose)
        limits = first, step, float(scan.range_min), float(scan.range_max)
        depth = depths(ranges, *limits[2:])
        swept = max(scan.sweep, self.period) * max(self._rates) if scan.sweep > 0.0 else 0.0
        fan = np.array((scan.stamp, *sensor, *limits[:3], n, self._turning, swept))
        count = clusters.find_clusters(
            (ranges, beam_directions(first, step, n), limits, sensor), self._clusters
        )
        found = self._clusters[:count]
        given = (
            self._tracks,
            self._history,
            found,
            (depth, fan, sensor),
            (self._free.ranges, self._free.fans),
        )
        cluster_of, taken, sensor = tracks.follow(*given, dt, self._speed)
        self._correction = compose(sensor, inverse(pose))
        self._number = tracks.begin(self._tracks, found, taken, scan.stamp, self._number)
        if self._free.due(scan.stamp):
            self._free.take(depth, fan)
            tracks.remember(self._history, self._free.newest, cluster_of, found)

    def _movers(self) -> Movers:
        rows = self._tracks[self._tracks[:, tracks.MOVES] > 0.0]
        back = inverse(self._correction)
        x, y = transform_point(back, rows[:, tracks.TX], rows[:, tracks.TY])
        vx, vy = transform_point((0.0, 0.0, back[2]), rows[:, tracks.VX], rows[:, tracks.VY])
        return Movers(rows[:, tracks.ID].astype(np.int64), x, y, vx, vy, rows[:, tracks.TR])


def warm_up() -> None:
    """Compile or load all kernels by running a temporary tracker on two scans of an approaching disc."""
    tracker = MoverTracker(1.0, 1.0, 0.1)
    for stamp, distance in ((0.0, 2.0), (0.1, 1.9)):
        ranges = np.where(abs(np.arange(41) - 20) < 8, distance, 5.0)
        tracker.update(LaserScan(stamp, -0.4, 0.02, 0.1, 10.0, ranges, (0.0, 0.0, 0.0)))
