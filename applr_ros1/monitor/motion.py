"""Velocity of the base derived from its poses, to cross-check the velocity in the odometry message.

CollisionMonitor holds one PoseMotion. The poses are corrected by ScanMatcher. They therefore show lateral slip, and
the true motion if the sign or size of the odometry's velocity is wrong.
"""

import math
from collections import deque
from typing import Deque, Tuple

from applr_ros1.common.angles import Pose, compose, inverse

Twist = Tuple[float, float]  # v [m/s], w [rad/s]
SPAN_S = 0.25  # time baseline of a velocity estimate [s]
SHORTEST_S = 0.08  # minimum time baseline of a velocity estimate [s]
# Tolerance for an accelerating base: a constant part [m/s, rad/s] plus a fraction of the velocity from the poses.
DIFFERENCE_M_S, DIFFERENCE_RAD_S = 0.15, 0.4
DIFFERENCE_SHARE = 0.2


class PoseMotion:
    """Velocity of the base, estimated from the poses of the last SPAN_S seconds.

    Attributes:
        velocity: (forward v [m/s], w [rad/s], leftward s [m/s]) in the base's frame; zeros until enough poses arrived.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all poses."""
        self._poses: Deque[Tuple[float, Pose]] = deque()
        self.velocity = (0.0, 0.0, 0.0)

    def take(self, stamp: float, pose: Pose) -> None:
        """Add the pose (x, y, yaw) [m, rad] of the base at `stamp` [s], and update the velocity."""
        poses = self._poses
        if poses and not 0.0 <= stamp - poses[-1][0] <= SPAN_S:  # The clock was set, or poses were missing.
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
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)  # heading halfway between both poses
        time = stamp - since
        self.velocity = (c * x + s * y) / time, yaw / time, (c * y - s * x) / time

    def contradicts(self, twist: Twist) -> bool:
        """Return whether the base moves opposite to the measured (v, w) [m/s, rad/s], or much faster."""
        return any(
            abs(moved) > limit
            and (moved * measured < 0.0 or abs(moved) > abs(measured) + limit + DIFFERENCE_SHARE * abs(moved))
            for moved, measured, limit in zip(self.velocity, twist, (DIFFERENCE_M_S, DIFFERENCE_RAD_S))
        )
