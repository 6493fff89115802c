"""Critic "twirling": the turn rate (TwirlingCostFunction)."""

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics.critic import Critic
from applr_ros1.planner.sampling_planner import CostTerm, Velocity

CRITIC = Critic(
    CostTerm(
        name="twirling",
        title="turning",
        parameter="twirling_scale",
        objection="turns the robot faster",
    ),
    scale="twirling_scale",
    value="|w| of the trajectory's velocity",
    refuses="nothing",
)


@kernel(inline="always")
def value(velocity: Velocity) -> float:
    """Return the value for the velocity of a trajectory."""
    return abs(velocity.w)


bound = value  # The value is known before the roll-out.
