"""Critic "twirling": the turn rate (TwirlingCostFunction)."""

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics.critic import CriticRow
from applr_ros1.planner.sampling_planner import Record, Velocity

ROW = CriticRow("twirling", "`twirling_scale`", "|w| of the trajectory's velocity", "nothing")


@kernel(inline="always")
def weight(p: Record) -> float:
    """Return the weight of the critic."""
    return p.twirling_scale


@kernel(inline="always")
def value(velocity: Velocity) -> float:
    """Return the value for the velocity of a trajectory."""
    return abs(velocity.w)


@kernel(inline="always")
def bound(velocity: Velocity) -> float:
    """Return the value, which is known before the roll-out."""
    return abs(velocity.w)
