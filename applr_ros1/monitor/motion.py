"""Velocity of the base derived from its poses, beside the velocity in the odometry message.

CollisionMonitor holds one PoseMotion. The poses are corrected by ScanMatcher, which alone estimates
how the wheels slip. They therefore show lateral slip, and the true motion if the sign or size of
the odometry's velocity is wrong.
"""

import math
from collections import deque
from typing import Deque, NamedTuple, Tuple

from applr_ros1.common.angles import Pose, compose, inverse

SPAN_S = 0.25  # time baseline of a velocity estimate [s]
SHORTEST_S = 0.08  # minimum time baseline of a velocity estimate [s]


class PoseVelocity(NamedTuple):
    """Velocity that poses show, in the base's frame: v, leftward [m/s], turn rate w [rad/s]."""

    v: float = 0.0
    w: float = 0.0
    leftward: float = 0.0


class PoseMotion:
    """Velocity of the base, estimated from its latest poses.

    Args:
        span: Time baseline of the estimate [s].

    Attributes:
        velocity: the PoseVelocity; zeros until enough poses arrived.
        baseline: Time between the poses of which it was estimated [s]; 0 if nothing is known.
        slide: forward speed of the poses less that of the odometry in the same time [m/s].
    """

    def __init__(self, span: float = SPAN_S) -> None:
        self._span = span
        self.clear()

    def clear(self) -> None:
        """Forget all poses."""
        # Stamp [s], pose, and distance driven ahead by the odometry [m]
        self._poses: Deque[Tuple[float, Pose, float]] = deque()
        self._latest_v = 0.0  # speed of the odometry with the latest pose [m/s]
        self.velocity = PoseVelocity()
        self.baseline = 0.0
        self.slide = 0.0

    def take(self, stamp: float, pose: Pose, v: float) -> None:
        """Add a pose, and update the velocity.

        Args:
            stamp: time of the pose [s].
            pose: (x, y, yaw) of the base [m, rad].
            v: forward speed that the odometry measures [m/s].
        """
        # The clock was set, or poses were missing.
        if self._poses and not 0.0 <= stamp - self._poses[-1][0] <= self._span:
            self.clear()
        if self._poses and stamp == self._poses[-1][0]:
            return
        driven = 0.0
        if self._poses:
            latest_stamp, _, latest_driven = self._poses[-1]
            driven = latest_driven + 0.5 * (self._latest_v + v) * (stamp - latest_stamp)
        self._poses.append((stamp, pose, driven))
        self._latest_v = v

        # Keep the latest pose that is at least as old as the baseline is long, as its start.
        while len(self._poses) > 1 and stamp - self._poses[1][0] >= self._span:
            self._poses.popleft()
        first_stamp, first_pose, first_driven = self._poses[0]
        baseline = stamp - first_stamp
        if baseline < SHORTEST_S:
            return
        self.baseline = baseline

        x, y, yaw = compose(inverse(first_pose), pose)
        turn_angle = math.remainder(yaw, 2.0 * math.pi)
        # On an arc, the base moves along the heading halfway between both poses.
        cos_half = math.cos(0.5 * turn_angle)
        sin_half = math.sin(0.5 * turn_angle)
        forward = cos_half * x + sin_half * y
        leftward = cos_half * y - sin_half * x
        self.velocity = PoseVelocity(forward / baseline, turn_angle / baseline, leftward / baseline)
        self.slide = (forward - (driven - first_driven)) / baseline
