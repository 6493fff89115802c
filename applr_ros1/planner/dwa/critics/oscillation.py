"""Critic "oscillation": bars a direction after a reversal until the robot has moved on.

This is OscillationCostFunction, see docs/explanation/planner_dwa.md, section 7. Samples in a barred
direction are no candidates at all (bounds.fill_bounds).
"""

from typing import Tuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.critics.critic import OSCILLATES, Critic
from applr_ros1.planner.sampling_planner import CostTerm, Record, Velocity

CRITIC = Critic(
    CostTerm(
        name="oscillation",
        title="oscillation",
        parameter="oscillation_reset_dist",
        objection="reverses the robot's direction",
        refusal="is barred after a change of direction, until the robot has moved by "
        "{oscillation_reset_dist:g} m (oscillation_reset_dist) or turned by "
        "{oscillation_reset_angle:g} rad (oscillation_reset_angle)",
    ),
    scale="",
    value="0",
    refuses="-5: barred by the flags of section 7",
)


@kernel(inline="always")
def value(state: Record, velocity: Velocity) -> float:
    """Return the value for the velocity of a trajectory."""
    return OSCILLATES if is_barred(state, velocity) else 0.0


@kernel
def is_barred(state: Record, velocity: Velocity) -> bool:
    """Return whether the oscillation flags bar this velocity. Zero is never barred."""
    return bool(
        (state.forward_pos_only and velocity.vx < 0)
        or (state.forward_neg_only and velocity.vx > 0)
        or (state.strafe_pos_only and velocity.vy < 0)
        or (state.strafe_neg_only and velocity.vy > 0)
        or (state.rot_pos_only and velocity.w < 0)
        or (state.rot_neg_only and velocity.w > 0)
    )


@kernel
def remember(p: Record, state: Record, start: Record, velocity: Velocity) -> None:
    """Update the oscillation flags with the velocity that a search chose.

    start: pose and velocity of this cycle, rounded to float32.
    """
    # 1. The signs of the chosen velocity. Sideways motion and turns count only while the robot
    # hardly drives (oscillation_cost_function.cpp, setOscillationFlags).
    has_reversed = _reverses(velocity.vx, state.forward_pos, state.forward_neg)
    (state.forward_pos_only, state.forward_neg_only, state.forward_pos, state.forward_neg) = _flags(
        velocity.vx,
        state.forward_pos_only,
        state.forward_neg_only,
        state.forward_pos,
        state.forward_neg,
    )
    if abs(velocity.vx) <= p.min_vel_trans:
        has_reversed |= _reverses(velocity.vy, state.strafing_pos, state.strafing_neg)
        (state.strafe_pos_only, state.strafe_neg_only, state.strafing_pos, state.strafing_neg) = (
            _flags(
                velocity.vy,
                state.strafe_pos_only,
                state.strafe_neg_only,
                state.strafing_pos,
                state.strafing_neg,
            )
        )
        has_reversed |= _reverses(velocity.w, state.rotating_pos, state.rotating_neg)
        (state.rot_pos_only, state.rot_neg_only, state.rotating_pos, state.rotating_neg) = _flags(
            velocity.w,
            state.rot_pos_only,
            state.rot_neg_only,
            state.rotating_pos,
            state.rotating_neg,
        )

    # 2. A reversal starts the distance anew after which all flags are cleared.
    if has_reversed:
        state.prev_x = start.x
        state.prev_y = start.y
        state.prev_theta = start.theta
    if (
        state.forward_pos_only
        or state.forward_neg_only
        or state.strafe_pos_only
        or state.strafe_neg_only
        or state.rot_pos_only
        or state.rot_neg_only
    ):
        # As in C++, differences are float32, their squares double, and the angle is not wrapped.
        dx = np.float64(np.float32(start.x) - np.float32(state.prev_x))
        dy = np.float64(np.float32(start.y) - np.float32(state.prev_y))
        turn = np.float64(np.float32(start.theta) - np.float32(state.prev_theta))
        has_moved = dx * dx + dy * dy > p.oscillation_reset_dist * p.oscillation_reset_dist
        if has_moved or abs(turn) > p.oscillation_reset_angle:
            clear(state)


@kernel
def _reverses(v: float, pos: float, neg: float) -> bool:
    """Return whether the velocity v of an axis is opposite to the axis's last motion."""
    return (v < 0 and pos != 0) or (v > 0 and neg != 0)


@kernel
def _flags(
    v: float, pos_only: float, neg_only: float, pos: float, neg: float
) -> Tuple[float, float, float, float]:
    """Return the four flags of one axis after a search chose the velocity v, zero for none."""
    # After a reversal only the new direction is allowed.
    if v < 0:
        if pos:
            neg_only = 1.0
        return pos_only, neg_only, 0.0, 1.0
    if v > 0:
        if neg:
            pos_only = 1.0
        return pos_only, neg_only, 1.0, 0.0
    return pos_only, neg_only, pos, neg


@kernel
def clear(state: Record) -> None:
    """Clear the flags of all directions. The pose of their last change is kept."""
    state.forward_pos_only = state.forward_neg_only = 0
    state.strafe_pos_only = state.strafe_neg_only = 0
    state.rot_pos_only = state.rot_neg_only = 0
    state.forward_pos = state.forward_neg = 0
    state.strafing_pos = state.strafing_neg = 0
    state.rotating_pos = state.rotating_neg = 0
