"""Comparison of what odometry states twice: the motion of the base, by its twists and by its poses.

The planner believes both. Home-made drivers and scan matchers often leave one of them at 0. Wheels
that slip move both.
"""

from __future__ import annotations

from typing import NamedTuple

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.monitor.motion import PoseMotion

SPAN_S = 1.0  # time over which the motion of the poses is measured [s]
PROOF_S = 2.0  # time for which a contradiction must last: longer than a jump of the pose shows [s]
STILL = 1e-3  # value below which a statement counts as 0 [m/s, rad/s]
TWIST = "twist"
POSE = "pose"


class Quantity(NamedTuple):
    """Velocity or turn rate of the base, for numbers and for people.

    Attributes:
        smallest_motion: Least value of a motion; the noise of a scan matcher's poses lies below it.
        unit: Unit of the value.
        noun: Name of what the twist states.
        verb: What the pose does.
        belief: What the planner believes of a robot whose twist is 0.
    """

    smallest_motion: float
    unit: str
    noun: str
    verb: str
    belief: str


SPEED = Quantity(0.05, "m/s", "velocity", "moves", "to stand")
TURN_RATE = Quantity(0.2, "rad/s", "turn rate", "turns", "not to turn")


class OdometryCheck:
    """Finds out whether the twists or the poses of an odometry stay 0 while the others move."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all messages."""
        self._motion = PoseMotion(SPAN_S)
        self._comparisons = (_QuantityComparison(SPEED), _QuantityComparison(TURN_RATE))

    def take(self, stamp: float, pose: Pose, twist: Twist) -> str:
        """Compare a message with those before it, and return `problem`.

        Args:
            stamp: Time of the message [s].
            pose: Pose (x, y, yaw) [m, m, rad] of the base.
            twist: Velocity (v, w) [m/s, rad/s] of the base.
        """
        v, _ = twist
        self._motion.take(stamp, pose, v)
        is_known = self._motion.baseline >= SPAN_S
        by_pose = self._motion.velocity
        for comparison, pose_value, twist_value in zip(self._comparisons, by_pose, twist):
            comparison.take(stamp, pose_value, twist_value, is_known)
        return self.problem

    @property
    def problem(self) -> str:
        """The contradiction in one line, or "". It stands until twist and poses move together."""
        speed, turn_rate = self._comparisons
        return speed.problem or turn_rate.problem

    @property
    def lacks_twist(self) -> bool:
        """True if twists stay 0 while the poses move."""
        return any(comparison.unfilled == TWIST for comparison in self._comparisons)


class _QuantityComparison:
    """Comparison of one quantity.

    Args:
        quantity: The quantity.

    Attributes:
        unfilled: TWIST or POSE, which stays 0 while the other one moves; "" if neither does.
        problem: The contradiction in one line, or "".
    """

    def __init__(self, quantity: Quantity) -> None:
        self._quantity = quantity
        self._suspect = ""  # TWIST or POSE, which is 0 since `_since`
        self._since = 0.0  # time [s]
        self.unfilled = ""
        self.problem = ""

    def take(self, stamp: float, pose_value: float, twist_value: float, is_known: bool) -> None:
        """Compare the values of a message with `stamp` [s], if that of the poses is known."""
        pose_moves = abs(pose_value) >= self._quantity.smallest_motion
        twist_moves = abs(twist_value) >= self._quantity.smallest_motion
        suspect = ""
        if is_known and pose_moves and abs(twist_value) < STILL:
            suspect = TWIST
        elif is_known and twist_moves and abs(pose_value) < STILL:
            suspect = POSE
        if suspect != self._suspect:
            self._suspect = suspect
            self._since = stamp

        if pose_moves and twist_moves:
            self.unfilled = ""
            self.problem = ""
        elif suspect and not self.problem and stamp - self._since >= PROOF_S:
            self.unfilled = suspect
            self.problem = self._in_words(abs(pose_value), abs(twist_value))

    def _in_words(self, pose_value: float, twist_value: float) -> str:
        """Return the contradiction in one line: problem, values, remedy."""
        quantity = self._quantity
        if self.unfilled == TWIST:
            motion = f"its pose {quantity.verb} at {pose_value:.2f} {quantity.unit}"
            return (
                f"the odometry's {quantity.noun} is 0 while {motion}: "
                f"the planner takes the robot {quantity.belief}; fill twist"
            )
        motion = f"its {quantity.noun} is {twist_value:.2f} {quantity.unit}"
        return (
            f"the odometry's pose stays while {motion}: "
            "the planner takes the robot to be where it was; fill pose"
        )
