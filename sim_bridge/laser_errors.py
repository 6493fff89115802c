"""Errors of a laser's scans besides white noise, as robot.yaml describes them (section laser)."""

from __future__ import annotations

from typing import Any

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array32
from applr_ros1.common.times import TIME_TOLERANCE_S
from applr_ros1.robots.robot import Laser

# Difference of neighbouring ranges from which on a near surface has its edge there [m]
EDGE_M = 0.3
PATCH_M = 0.2  # width of a patch of the world that is dark or glossy [m]
# Tangent of the angle at which the error of incidence has fallen to a third
INCIDENCE_TANGENT = 0.18
PATCHES = 128  # number of patches along x and y after which the pattern repeats


class LaserErrors:
    """Draws the errors of one laser's scans, and remembers where late scans were measured.

    Args:
        laser: Description of the laser with its errors.
        state: RobotState at the start.
        rng: Random numbers of the errors.

    Attributes:
        past: States of the robot. A scan that is stamped now was measured in the first.
    """

    def __init__(self, laser: Laser, state: Any, rng: np.random.Generator) -> None:
        self._laser = laser
        self._rng = rng
        # Surfaces in a dark patch lose ranges in every scan: an obstacle flickers as a whole.
        self._dark = rng.random((PATCHES, PATCHES)) < laser.dark
        self.past = [state]

    def remember(self, state: Any) -> None:
        """Add a state to the past, and forget states that are too old."""
        self.past.append(state)
        latest = state.time - self._laser.stamp_delay + TIME_TOLERANCE_S
        while len(self.past) > 1 and self.past[1].time <= latest:
            del self.past[0]

    def loses_scan(self) -> bool:
        """Return whether the scan of now is missing. The first one never is."""
        return self.past[-1].time > 0.0 and self._rng.random() < self._laser.gaps

    def add(self, ranges: Array32, pose: Pose) -> None:
        """Add the errors to exact `ranges` (beams,) [m] of a laser at `pose` [m, m, rad]."""
        laser = self._laser
        rng = self._rng
        exact = np.where(np.isfinite(ranges), ranges, laser.range_max)
        steps = np.diff(exact)
        step_sizes = np.abs(steps)

        # The neighbour on the same surface, which is the nearer one, gives the incidence.
        slopes = np.minimum(np.append(step_sizes, np.inf), np.insert(step_sizes, 0, np.inf))
        slopes /= exact * laser.increment  # tangents of the angles of incidence
        ranges += laser.incidence_error * np.exp(-np.square(slopes / INCIDENCE_TANGENT))
        ranges += laser.range_noise * exact * rng.standard_normal(len(exact))

        # At an edge, the spot of a beam covers both surfaces. Its range lies between theirs.
        is_seen = exact < laser.range_max
        edges = np.flatnonzero((step_sizes > EDGE_M) & is_seen[1:] & is_seen[:-1])
        edges = edges[rng.random(len(edges)) < laser.mixed]
        behind = edges + (steps[edges] > 0.0)
        ranges[behind] = exact[behind] - rng.random(len(edges)) * step_sizes[edges]

        # Dark and glossy surfaces
        x, y, yaw = pose
        angles = yaw + laser.first_angle + laser.increment * np.arange(len(exact))
        columns = np.floor((x + exact * np.cos(angles)) / PATCH_M).astype(int)
        rows = np.floor((y + exact * np.sin(angles)) / PATCH_M).astype(int)
        is_dark = is_seen & self._dark[rows % PATCHES, columns % PATCHES]
        ranges[is_dark & (rng.random(len(exact)) < laser.dropouts)] = np.inf
