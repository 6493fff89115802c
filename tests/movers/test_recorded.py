"""Tests of the tracker on recorded scenes of simulated robots, stored in files beside this one.

A file has these arrays. limits: first angle, increment, range_min, range_max. times: (n,) [s].
poses: (n, 3) poses of the laser by odometry. steps: (n, beams) differences of the ranges to those
of the previous beam, in 5 mm; a range of -1 is +inf, 0 is too near. truth: (n, 8, 5) x, y, radius,
vx, vy of the nearest moving obstacles in the odometry's frame.
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
SLOWEST = 0.3
FASTEST = 5.0


class Comparison:
    """Errors of a tracker in a recorded scene.

    Attributes:
        seconds: Duration of the scene [s].
        in_view: Time for which obstacles should be tracked, summed over obstacles [s].
        known: Part of it for which they are [s].
        position, velocity: Errors of these tracks [m, m/s].
        tracked, wrong, uncertain: Number of tracks in all scans, of those without an obstacle, and
            of those whose velocity was never certain.
    """

    def __init__(self, robot, name):
        self.tracker = MoverTracker.of(robots.load(robot))
        self.stamp = None
        self.position = []
        self.velocity = []
        self.seconds = 0.0
        self.in_view = 0.0
        self.known = 0.0
        self.tracked = 0
        self.wrong = 0
        self.uncertain = 0
        with np.load(Path(__file__).parent / f"{name}.npz") as scene:
            limits = scene["limits"].tolist()
            recorded_rows = zip(
                scene["times"],
                scene["poses"],
                scene["steps"],
                scene["truth"],
            )
            for stamp, pose, steps, truth in recorded_rows:
                units = np.cumsum(steps).astype(np.float32)
                ranges = np.where(units < 0, np.float32(np.inf), np.float32(0.005) * units)
                scan = LaserScan(
                    float(stamp),
                    *limits,
                    ranges,
                    tuple(pose.tolist()),
                )
                self.add(scan, truth)

    def add(self, scan, truth):
        """Update the tracker with a scan, and compare it with the true obstacles (8, 5)."""
        movers = self.tracker.update(scan)
        interval = 0.0 if self.stamp is None else scan.stamp - self.stamp
        self.stamp = scan.stamp
        self.seconds += interval
        has_no_obstacle = np.ones(len(movers.id), bool)
        for x, y, radius, vx, vy in truth.tolist():
            distances = np.hypot(movers.x - x, movers.y - y)
            has_no_obstacle &= distances > radius + NEAR
            if not should_be_tracked(scan, x, y, radius, math.hypot(vx, vy)):
                continue
            self.in_view += interval
            if len(distances) and distances.min() <= radius + NEAR:
                nearest = int(distances.argmin())
                error_vx = movers.vx[nearest] - vx
                error_vy = movers.vy[nearest] - vy
                self.known += interval
                self.position.append(distances[nearest])
                self.velocity.append(math.hypot(error_vx, error_vy))
        self.tracked += len(has_no_obstacle)
        self.uncertain += len(has_no_obstacle) - len(movers.certain().id)
        self.wrong += int(has_no_obstacle.sum())


def should_be_tracked(scan, x, y, radius, speed):
    """Return whether an obstacle of some speed [m/s] is near, hit by three beams, and moves."""
    point_x, point_y = hits(scan).T
    from_centre = np.hypot(point_x - x, point_y - y)
    # 4 cm are four times the noise of the burger's laser.
    hit_count = (np.abs(from_centre - radius) < 0.04).sum()
    laser_x, laser_y, _ = scan.sensor_pose
    distance = math.hypot(x - laser_x, y - laser_y)
    return hit_count >= 3 and distance <= VIEW and SLOWEST < speed < FASTEST


def hits(scan):
    """Return the points (n, 2) of a scan [m], in its frame."""
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    is_hit = (scan.ranges >= scan.range_min) & (scan.ranges < scan.range_max)
    ahead = scan.ranges[is_hit] * np.cos(angles[is_hit])
    leftward = scan.ranges[is_hit] * np.sin(angles[is_hit])
    return np.column_stack(transform_point(scan.sensor_pose, ahead, leftward))


def test_wheel_slip_causes_no_false_detections():
    """The Jackal pushes backwards against one of several posts. The file has half of its beams."""
    result = Comparison("jackal", "jackal_slips")
    assert result.seconds > 1.5
    assert result.tracked == 0


@pytest.mark.parametrize(
    ("robot", "scene", "uncertain"),
    [
        ("jackal", "jackal_among_movers", 3),
        ("turtlebot3_burger", "burger_among_movers", 0),
    ],
)
def test_moving_obstacles_of_a_room_are_tracked(robot, scene, uncertain):
    """Medium and fast obstacles of DynaBARN cross, and occlude each other."""
    result = Comparison(robot, scene)
    # The limits have some distance from what the tracker reaches, so that a change of its rules
    # shows here before it matters.
    assert result.in_view > 4.0
    assert result.known / result.in_view > 0.7
    assert np.median(result.position) < 0.06
    assert np.median(result.velocity) < 0.15
    assert result.wrong < 0.05 * result.tracked
    assert result.uncertain == uncertain
