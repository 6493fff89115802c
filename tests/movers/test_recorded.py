"""The tracker on scenes that a simulated robot drove through, kept as files beside this one.

limits: first angle, increment, range_min, range_max. times (n,), poses (n, 3) of the laser by the odometry. steps
(n, beams): each range less that of the beam before [5 mm]; ranges of -1 are +inf, 0 is too near to tell. truth
(n, 8, 5): x, y, radius, vx, vy of the nearest movers in the odometry's frame.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import transform_point
from applr_ros1.common.scan import LaserScan
from applr_ros1.movers.tracker import MoverTracker

VIEW = 5.0  # m from the laser within which a mover that at least three beams hit should be known
NEAR = 0.4  # m beyond a true disc within which a mover of the tracker is meant to be it
SPEEDS = 0.3, 5.0  # m/s; what is slower need not be known, what is faster has jumped back to its start


class Comparison:
    """Errors of a tracker in a recorded scene: position and velocity [m, m/s] of known movers, times and counts."""

    def __init__(self, robot, name):
        self.tracker, self.last = MoverTracker.of(robots.load(robot)), math.nan
        self.position, self.velocity = [], []
        self.seconds = self.in_view = self.known = 0.0
        self.marks = self.wrong = 0  # movers that the tracker names in all scans; those of them where none is
        with np.load(Path(__file__).parent / f"{name}.npz") as scene:
            for stamp, pose, steps, truth in zip(*(scene[key] for key in ("times", "poses", "steps", "truth"))):
                ranges = np.cumsum(steps).astype(np.float32)
                ranges = np.where(ranges < 0, np.float32(np.inf), np.float32(0.005) * ranges)
                self.add(LaserScan(float(stamp), *scene["limits"].tolist(), ranges, tuple(pose.tolist())), truth)

    def add(self, scan, truth):
        movers = self.tracker.update(scan)
        dt, self.last = scan.stamp - self.last, scan.stamp
        dt = 0.0 if math.isnan(dt) else dt
        self.seconds += dt
        points, wrong = hits(scan), np.ones(len(movers.id), bool)
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
        self.marks += len(wrong)
        self.wrong += int(wrong.sum())


def hits(scan):
    """(n, 2) the points of a scan [m], in its frame."""
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    hit = (scan.ranges >= scan.range_min) & (scan.ranges < scan.range_max)
    r, a = scan.ranges[hit], angles[hit]
    return np.column_stack(transform_point(scan.sensor_pose, r * np.cos(a), r * np.sin(a)))


def test_a_base_whose_wheels_slip_sees_no_movers():
    """The Jackal pushes backwards against a post, among others; half of its beams."""
    found = Comparison("jackal", "jackal_slips")
    assert found.seconds > 1.5
    assert found.marks == 0


@pytest.mark.parametrize(
    ("robot", "scene"), [("jackal", "jackal_among_movers"), ("turtlebot3_burger", "burger_among_movers")]
)
def test_movers_of_a_room_are_known(robot, scene):
    """They cross before and behind each other; DynaBARN's kinds, medium and fast."""
    found = Comparison(robot, scene)
    assert found.in_view > 4.0
    assert found.known / found.in_view > 0.7
    assert np.median(found.position) < 0.06
    assert np.median(found.velocity) < 0.15
    assert found.wrong < 0.05 * found.marks
