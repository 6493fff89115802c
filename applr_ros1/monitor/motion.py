"""Velocity of the base by its poses, which the velocity that odometry states is checked against.

CollisionMonitor holds one PoseMotion. Its poses are ScanMatcher's: they show how far the base slides, also sideways,
and in which direction it moves where the stated velocity has the wrong sign or size.
"""

import math
from collections import deque

from applr_ros1.common.angles import compose, inverse

SPAN_S = 0.25  # [s]: poses so long ago are compared with the newest one
SHORTEST_S = 0.08  # [s]: over less nothing is said
DIFFERENCE_M_S, DIFFERENCE_RAD_S = 0.15, 0.4  # [m/s, rad/s]: differences up to these, and
DIFFERENCE_SHARE = 0.2  # up to this share of the velocity, are those of a velocity that changes


class PoseMotion:
    """Velocity of the base from its poses of the last quarter of a second.

    Attributes:
        velocity: (v ahead [m/s], w [rad/s], s to the left [m/s]) in the base's frame; zeros until poses have come.
    """

    def __init__(self):
        self.clear()

    def clear(self):
        """Forget all poses."""
        self._poses = deque()
        self.velocity = (0.0, 0.0, 0.0)

    def take(self, stamp, pose):
        """Take the base's pose (x, y, yaw) [m, rad] at `stamp` [s]."""
        poses = self._poses
        if poses and not 0.0 <= stamp - poses[-1][0] <= SPAN_S:  # the clock was set, or poses ceased
            self.clear()
            poses = self._poses
        if poses and stamp == poses[-1][0]:
            return
        poses.append((stamp, pose))
        while stamp - poses[1 if len(poses) > 1 else 0][0] >= SPAN_S:
            poses.popleft()
        since, before = poses[0]
        if stamp - since < SHORTEST_S:
            return
        x, y, yaw = compose(inverse(before), pose)
        yaw = math.remainder(yaw, 2.0 * math.pi)
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)  # the direction in the middle of the way
        time = stamp - since
        self.velocity = (c * x + s * y) / time, yaw / time, (c * y - s * x) / time

    def contradicts(self, twist):
        """Return whether the base moves the other way than the measured (v, w), or much faster."""
        return any(
            abs(moved) > limit
            and (moved * stated < 0.0 or abs(moved) > abs(stated) + limit + DIFFERENCE_SHARE * abs(moved))
            for moved, stated, limit in zip(self.velocity, twist, (DIFFERENCE_M_S, DIFFERENCE_RAD_S))
        )
