"""The velocities of a cycle: dynamic window and values of each axis. docs/explanation/planner_dwa.md section 4."""

import math

import numpy as np

from applr_ros1.common.kernels import kernel


@kernel
def single(value):
    """`value` rounded to float32, as a double."""
    return np.float64(np.float32(value))


@kernel(error_model="numpy")
def sample_axes(p, scratch, plan):
    """Fill the values of the axes; returns how many there are of vx, vy and w. Samples run over w first, vx last.

    plan: (k, 2 or 3) [m], not empty; its last point slows the robot down where use_dwa is off.
    """
    start = scratch.start
    most_x, most_y, period = p.max_vel_x, p.max_vel_y, p.sim_period
    if not p.use_dwa:
        last = plan.shape[0] - 1
        dx = np.float32(plan[last, 0]) - np.float32(start[0])
        dy = np.float32(plan[last, 1]) - np.float32(start[1])
        speed = math.hypot(np.float64(dx), np.float64(dy)) / p.sim_time
        most_x = max(min(most_x, speed), p.min_vel_x)
        most_y = max(min(most_y, speed), p.min_vel_y)
        period = p.sim_time
    nx = _window(p.min_vel_x, most_x, start[3], p.acc_lim_x * period, p.vx_samples, scratch.xs)
    ny = _window(p.min_vel_y, most_y, start[4], p.acc_lim_y * period, p.vy_samples, scratch.ys)
    nw = _window(-p.max_vel_theta, p.max_vel_theta, start[5], p.acc_lim_theta * period, p.vth_samples, scratch.ws)
    return nx, ny, nw


@kernel
def _window(least, most, velocity, change, n, values):
    """The values of one axis between its limits and what can be reached from `velocity`."""
    return spread(single(max(least, velocity - change)), single(min(most, velocity + change)), n, values)


@kernel
def spread(bottom, top, n, values):
    """Fill `values` from bottom to top in equal steps, zero between them included; returns how many there are.

    Repeated addition, every value rounded to float32. One value if both ends are the same, else two at least; values
    descend where bottom is above top. velocity_iterator.h.
    """
    if bottom == top:
        values[0] = bottom
        return 1
    n = max(n, 2)
    step = (top - bottom) / (n - 1)
    following = bottom
    count = 0
    for _ in range(n - 1):
        current = following
        following += step
        values[count] = single(current)
        count += 1
        if current < 0 and following > 0:
            values[count] = 0.0
            count += 1
    values[count] = single(top)
    return count + 1
