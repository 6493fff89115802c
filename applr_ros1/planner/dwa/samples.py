"""Velocity samples of a cycle and their trajectories (SimpleTrajectoryGenerator, velocity_iterator.h).

See docs/explanation/planner_dwa.md, section 4 for the dynamic window and the values of each axis, and section 5 for the
trajectory of a sample. Stored poses and velocities are rounded to float32, intermediate values are double.
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.records import Scratch
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK
from applr_ros1.planner.sampling_planner import Record, Triple


@kernel
def single(value: float) -> float:
    """Return `value` rounded to float32, as a double."""
    return np.float64(np.float32(value))


@kernel(error_model="numpy")
def sample_axes(p: Record, scratch: Scratch, plan: Data) -> Tuple[int, int, int]:
    """Fill the sampled values of vx, vy and w, and return their numbers. From sample to sample, w varies fastest.

    plan: points (k, 2 or 3) [m], not empty. Without use_dwa, the distance to its last point limits the speed.
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
    nw = _window(
        -p.max_vel_theta,
        p.max_vel_theta,
        start[5],
        p.acc_lim_theta * period,
        p.vth_samples,
        scratch.ws,
    )
    return nx, ny, nw


@kernel
def sample_of(scratch: Scratch, axes: Tuple[int, int, int], number: int) -> Triple:
    """Return the sample (vx, vy, w) with this number."""
    _, ny, nw = axes
    return scratch.xs[number // (nw * ny)], scratch.ys[number // nw % ny], scratch.ws[number % nw]


@kernel
def _window(
    least: float, most: float, velocity: float, change: float, n: float, values: Data
) -> int:
    """Fill the sampled values of one axis: within its limits, and at most `change` away from `velocity`."""
    return spread(
        single(max(least, velocity - change)), single(min(most, velocity + change)), n, values
    )


@kernel
def spread(bottom: float, top: float, n: float, values: Data) -> int:
    """Fill `values` from bottom to top in equal steps, adding a zero between different signs; return their number.

    The values come from repeated addition, each rounded to float32 (velocity_iterator.h). There is one value if bottom
    equals top, otherwise there are at least two. The values descend if bottom is above top.
    """
    if bottom == top:
        values[0] = bottom
        return 1
    n = max(int(n), 2)
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
def ground_speed(vx: float, vy: float) -> float:
    """Return the speed over ground [m/s]."""
    return abs(vx) if vy == 0.0 else math.hypot(vx, vy)


@kernel
def is_too_fast(p: Record, speed: float) -> bool:
    """Return whether samples of this speed over ground are rejected."""
    return p.max_vel_trans >= 0 and speed - SLACK > p.max_vel_trans


@kernel
def least_turn(p: Record, speed: float) -> float:
    """Return the minimum turn rate [rad/s] of samples at this speed over ground, or -1 if none applies."""
    if p.min_vel_trans >= 0 and speed + SLACK < p.min_vel_trans and p.min_vel_theta >= 0:
        return p.min_vel_theta
    return -1.0


@kernel(error_model="numpy")
def linear_steps(p: Record, speed: float) -> float:
    """Return the number of steps that a speed over ground requires, not yet rounded."""
    return speed * p.sim_time / p.sim_granularity


@kernel(error_model="numpy")
def angular_steps(p: Record, w: float) -> float:
    """Return the number of steps that a turn rate requires, not yet rounded."""
    return abs(w) * p.sim_time / p.angular_sim_granularity


@kernel
def step_count(p: Record, sample: Triple) -> int:
    """Return the number of steps of the sample (vx, vy, w), or 0 to reject it."""
    vx, vy, w = sample
    speed = ground_speed(vx, vy)
    if is_too_fast(p, speed) or abs(w) + SLACK < least_turn(p, speed):
        return 0
    return int(math.ceil(max(linear_steps(p, speed), angular_steps(p, w))))


@kernel
def ramp(target: float, velocity: float, change: float) -> float:
    """Return the velocity moved towards `target` by at most `change`."""
    if velocity < target:
        return single(min(target, velocity + change))
    return single(max(target, velocity - change))


@kernel
def ramped(p: Record, sample: Triple, now: Triple, dt: float) -> Triple:
    """Return the velocity (vx, vy, w) after dt of acceleration from `now` towards the sample."""
    vx = ramp(sample[0], now[0], p.acc_lim_x * dt)
    vy = ramp(sample[1], now[1], p.acc_lim_y * dt)
    return vx, vy, ramp(sample[2], now[2], p.acc_lim_theta * dt)


@kernel
def commanded(p: Record, start: Data, sample: Triple, steps: int) -> Triple:
    """Return the velocity of a sample's trajectory: the sample, or without use_dwa the first step of the ramp."""
    return (
        sample
        if p.use_dwa
        else ramped(p, sample, (start[3], start[4], start[5]), p.sim_time / steps)
    )


@kernel
def move(x: float, y: float, theta: float, velocity: Triple, dt: float) -> Triple:
    """Return the pose after dt."""
    vx, vy, w = velocity
    c = math.cos(theta)
    s = math.sin(theta)
    if vy == 0.0:
        return single(x + vx * c * dt), single(y + vx * s * dt), single(theta + w * dt)
    return (
        single(x + (vx * c + vy * math.cos(math.pi / 2 + theta)) * dt),
        single(y + (vx * s + vy * math.sin(math.pi / 2 + theta)) * dt),
        single(theta + w * dt),
    )


@kernel
def roll_out(p: Record, start: Data, sample: Triple, points: Data) -> None:
    """Write the poses x, y, theta before each step to `points` (steps, 3). The first is the robot's current pose."""
    steps = points.shape[0]
    dt = p.sim_time / steps if steps > 0 else 0.0
    x, y, theta = start[0], start[1], start[2]
    now = commanded(p, start, sample, steps) if steps > 0 else sample
    for i in range(steps):
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = theta
        if not p.use_dwa:
            now = ramped(p, sample, now, dt)
        x, y, theta = move(x, y, theta, now, dt)
