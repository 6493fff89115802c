"""Keeps the robot from going to and fro: a direction just left is barred until it has moved on.

OscillationCostFunction; docs/explanation/planner_dwa.md section 7.
"""

import numpy as np

from applr_ros1.common.kernels import kernel


@kernel
def is_barred(state, vx, vy, w):
    """Whether the flags bar this velocity; zero always passes."""
    return (
        (state.forward_pos_only and vx < 0)
        or (state.forward_neg_only and vx > 0)
        or (state.strafe_pos_only and vy < 0)
        or (state.strafe_neg_only and vy > 0)
        or (state.rot_pos_only and w < 0)
        or (state.rot_neg_only and w > 0)
    )


@kernel
def remember(p, state, x, y, theta, vx, vy, w):
    """Take the chosen velocity into the flags, and clear them once the robot has moved on from the pose of the last.

    x, y, theta: the pose of this cycle, float32 values.
    """
    changed = False
    if vx < 0:
        if state.forward_pos:
            state.forward_neg_only = 1
            changed = True
        state.forward_pos = 0
        state.forward_neg = 1
    elif vx > 0:
        if state.forward_neg:
            state.forward_pos_only = 1
            changed = True
        state.forward_neg = 0
        state.forward_pos = 1
    if abs(vx) <= p.min_vel_trans:
        if vy < 0:
            if state.strafing_pos:
                state.strafe_neg_only = 1
                changed = True
            state.strafing_pos = 0
            state.strafing_neg = 1
        elif vy > 0:
            if state.strafing_neg:
                state.strafe_pos_only = 1
                changed = True
            state.strafing_neg = 0
            state.strafing_pos = 1
        if w < 0:
            if state.rotating_pos:
                state.rot_neg_only = 1
                changed = True
            state.rotating_pos = 0
            state.rotating_neg = 1
        elif w > 0:
            if state.rotating_neg:
                state.rot_pos_only = 1
                changed = True
            state.rotating_neg = 0
            state.rotating_pos = 1
    if changed:
        state.prev_x = x
        state.prev_y = y
        state.prev_theta = theta
    if (
        state.forward_pos_only
        or state.forward_neg_only
        or state.strafe_pos_only
        or state.strafe_neg_only
        or state.rot_pos_only
        or state.rot_neg_only
    ):
        dx = np.float64(np.float32(x) - np.float32(state.prev_x))
        dy = np.float64(np.float32(y) - np.float32(state.prev_y))
        turn = np.float64(np.float32(theta) - np.float32(state.prev_theta))
        far = dx * dx + dy * dy > p.oscillation_reset_dist * p.oscillation_reset_dist
        if far or abs(turn) > p.oscillation_reset_angle:
            clear(state)


@kernel
def clear(state):
    """Forget all directions; the pose of the last change stays."""
    state.forward_pos_only = state.forward_neg_only = 0
    state.strafe_pos_only = state.strafe_neg_only = 0
    state.rot_pos_only = state.rot_neg_only = 0
    state.forward_pos = state.forward_neg = 0
    state.strafing_pos = state.strafing_neg = 0
    state.rotating_pos = state.rotating_neg = 0
