"""Tests of the tracker on recorded scenes of simulated robots, stored in files beside this one.

A file has these arrays. limits: first angle, increment, range_min, range_max. times: (n,) [s].
poses: (n, 3) poses of
the laser by odometry. steps: (n, beams) differences of the ranges to those of the previous beam, in
5 mm; a range of -1 is +inf, 0 is too near. truth: (n, 8, 5) x, y, radius, vx, vy of the nearest
moving obstacles in the odometry's frame.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import transform_point
from applr_ros1.common.scan import LaserScan
from applr_ros1.movers.tracker import MoverTracker

# Distance from the laser up to which obstacles hit by three beams should be tracked [m]
VIEW = 5.0
NEAR = 0.4  # maximum distance of a track from the edge of its true disc [m]
# Speeds between which obstacles should be tracked; faster ones jumped back to their start [m/s]
SPEEDS = (
    0.3,
    5.0,
)


class Comparison:
    """Errors of a tracker in a recorded scene: position and velocity [m, m/s] of tracks, times and
    counts.
    """

    def __init__(self, robot, name):
        self.tracker = MoverTracker.of(robots.load(robot))
        self.last = math.nan
        self.position = []
        self.velocity = []
        self.seconds = self.in_view = self.known = 0.0
        self.tracked = self.wrong = (
            0  # numbers of tracked obstacles in all scans, and of false detections
        )
        with np.load(Path(__file__).parent / f"{name}.npz") as scene:
            for stamp, pose, steps, truth in zip(
                *(scene[key] for key in ("times", "poses", "steps", "truth"))
            ):
                ranges = np.cumsum(steps).astype(np.float32)
                ranges = np.where(ranges < 0, np.float32(np.inf), np.float32(0.005) * ranges)
                self.add(
                    LaserScan(
                        float(stamp), *scene["limits"].tolist(), ranges, tuple(pose.tolist())
                    ),
                    truth,
                )

    def add(self, scan, truth):
        movers = self.tracker.update(scan)
        dt = scan.stamp - self.last
        self.last = scan.stamp
        dt = 0.0 if math.isnan(dt) else dt
        self.seconds += dt
        points = hits(scan)
        wrong = np.ones(len(movers.id), bool)
        for x, y, r, vx, vy in truth.tolist():
            distances = np.hypot(movers.x - x, movers.y - y)
            wrong &= distances > r + NEAR
            on = np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - r) < 0.04
            away = math.hypot(x - scan.sensor_pose[0], y - scan.sensor_pose[1])
            if on.sum() < 3 or away > VIEW or not SPEEDS[0] < math.hypot(vx, vy) < SPEEDS[1]:
                continue
            self.in_view += dt
            if len(distances) and distances.min() <= r + NEAR:
                k = int(distances.argmin())
                self.known += dt
                self.position.append(distances[k])
                self.velocity.append(math.hypot(movers.vx[k] - vx, movers.vy[k] - vy))
        self.tracked += len(wrong)
        self.wrong += int(wrong.sum())


def hits(scan):
    """Return the points (n, 2) of a scan [m], in its frame."""
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    hit = (scan.ranges >= scan.range_min) & (scan.ranges < scan.range_max)
    r = scan.ranges[hit]
    a = angles[hit]
    return np.column_stack(transform_point(scan.sensor_pose, r * np.cos(a), r * np.sin(a)))


def test_wheel_slip_causes_no_false_detections():
    """The Jackal pushes backwards against one of several posts. The file has half of its beams."""
    result = Comparison("jackal", "jackal_slips")
    assert result.seconds > 1.5
    assert result.tracked == 0


@pytest.mark.parametrize(
    ("robot", "scene"),
    [("jackal", "jackal_among_movers"), ("turtlebot3_burger", "burger_among_movers")],
)
def test_moving_obstacles_of_a_room_are_tracked(robot, scene):
    """Medium and fast obstacles of DynaBARN cross, and occlude each other."""
    result = Comparison(robot, scene)
    assert result.in_view > 4.0
    assert result.known / result.in_view > 0.7
    assert np.median(result.position) < 0.06
    assert np.median(result.velocity) < 0.15
    assert result.wrong < 0.05 * result.tracked
