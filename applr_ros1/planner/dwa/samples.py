"""The velocity samples of a cycle and their trajectories (SimpleTrajectoryGenerator, velocity_iterator.h).

docs/explanation/planner_dwa.md sections 4 and 5: dynamic window and values of each axis; the trajectory of a sample.
Every pose and velocity is rounded to float32 when it is stored; what lies between is double.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK


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


@kernel
def ground_speed(vx, vy):
    """The speed over ground [m/s]."""
    return abs(vx) if vy == 0.0 else math.hypot(vx, vy)


@kernel
def is_too_fast(p, speed):
    """Return true if samples of this speed over ground are refused."""
    return p.max_vel_trans >= 0 and speed - SLACK > p.max_vel_trans


@kernel
def least_turn(p, speed):
    """The turn rate [rad/s] that samples of this speed over ground need; -1 if none."""
    if p.min_vel_trans >= 0 and speed + SLACK < p.min_vel_trans and p.min_vel_theta >= 0:
        return p.min_vel_theta
    return -1.0


@kernel(error_model="numpy")
def linear_steps(p, speed):
    """The steps that a speed over ground asks for, not yet a whole number."""
    return speed * p.sim_time / p.sim_granularity


@kernel(error_model="numpy")
def angular_steps(p, w):
    """The steps that a turn rate asks for, not yet a whole number."""
    return abs(w) * p.sim_time / p.angular_sim_granularity


@kernel
def step_count(p, vx, vy, w):
    """Into how many steps the sample (vx, vy, w) is divided; 0 refuses it."""
    speed = ground_speed(vx, vy)
    if is_too_fast(p, speed) or abs(w) + SLACK < least_turn(p, speed):
        return 0
    return int(math.ceil(max(linear_steps(p, speed), angular_steps(p, w))))


@kernel
def ramp(target, velocity, change):
    """The velocity on its way to `target`, at most `change` nearer."""
    if velocity < target:
        return single(min(target, velocity + change))
    return single(max(target, velocity - change))


@kernel
def ramped(p, vx, vy, w, vx_now, vy_now, w_now, dt):
    """All three velocities after dt on their way from the present ones to the sample."""
    return (
        ramp(vx, vx_now, p.acc_lim_x * dt),
        ramp(vy, vy_now, p.acc_lim_y * dt),
        ramp(w, w_now, p.acc_lim_theta * dt),
    )


@kernel
def commanded(p, start, vx, vy, w, steps):
    """The velocity that the trajectory of a sample stands for: the sample, or one step of the ramp towards it."""
    if p.use_dwa:
        return vx, vy, w
    return ramped(p, vx, vy, w, start[3], start[4], start[5], p.sim_time / steps)


@kernel
def move(x, y, theta, c, s, vx, vy, w, dt):
    """The pose after dt; c and s are cosine and sine of theta."""
    if vy == 0.0:
        return single(x + vx * c * dt), single(y + vx * s * dt), single(theta + w * dt)
    return (
        single(x + (vx * c + vy * math.cos(math.pi / 2 + theta)) * dt),
        single(y + (vx * s + vy * math.sin(math.pi / 2 + theta)) * dt),
        single(theta + w * dt),
    )


@kernel
def roll_out(p, start, vx, vy, w, points):
    """Write the poses x, y, theta before each step into `points` (steps, 3): the first is the robot's own."""
    steps = points.shape[0]
    dt = p.sim_time / steps if steps > 0 else 0.0
    x, y, theta = start[0], start[1], start[2]
    vx_now, vy_now, w_now = commanded(p, start, vx, vy, w, steps) if steps > 0 else (vx, vy, w)
    for i in range(steps):
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = theta
        if not p.use_dwa:
            vx_now, vy_now, w_now = ramped(p, vx, vy, w, vx_now, vy_now, w_now, dt)
        x, y, theta = move(x, y, theta, math.cos(theta), math.sin(theta), vx_now, vy_now, w_now, dt)


@kernel
def take_start(start, x, y, yaw, vx, vy, w):
    """Pose and velocity (6,) as the planner uses them: float32, angle and turn rate already through a quaternion."""
    start[0] = np.float32(x)
    start[1] = np.float32(y)
    start[2] = np.float32(yaw)
    start[3] = np.float32(vx)
    start[4] = np.float32(vy)
    start[5] = np.float32(w)
