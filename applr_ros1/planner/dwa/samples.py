"""Velocity samples of a cycle and their trajectories.

The rules are those of SimpleTrajectoryGenerator and velocity_iterator.h.
See docs/explanation/planner_dwa.md, section 4 for the dynamic window and the values of each axis,
and section 5 for the trajectory of a sample. Stored poses and velocities are rounded to float32,
intermediate values are double.
"""

import math
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.dwa.records import DWAScratch
from applr_ros1.planner.parameters.dwa_planner_parameters import SLACK
from applr_ros1.planner.sampling_planner import Record, Velocity, single


class SampleCounts(NamedTuple):
    """Number of sampled values per axis. Samples are numbered with w varying fastest, then vy."""

    vx: int
    vy: int
    w: int


@kernel(error_model="numpy")
def sample_axes(p: Record, scratch: DWAScratch, plan: Data) -> SampleCounts:
    """Fill the sampled values of vx, vy and w, and return their numbers.

    plan: points (k, 2 or 3) [m], not empty. Without use_dwa, the distance to its last point limits
    the speed, so that the robot arrives there within sim_time.
    """
    start = scratch.start[0]
    max_vx = p.max_vel_x
    max_vy = p.max_vel_y
    period = p.sim_period
    if not p.use_dwa:
        # C++ subtracts float32 values here, and rounds each difference before hypot.
        last_point = plan.shape[0] - 1
        dx = np.float32(plan[last_point, 0]) - np.float32(start.x)
        dy = np.float32(plan[last_point, 1]) - np.float32(start.y)
        arrival_speed = math.hypot(np.float64(dx), np.float64(dy)) / p.sim_time
        max_vx = max(min(max_vx, arrival_speed), p.min_vel_x)
        max_vy = max(min(max_vy, arrival_speed), p.min_vel_y)
        period = p.sim_time

    change = p.acc_lim_x * period
    vx_count = _fill_window(p.min_vel_x, max_vx, start.vx, change, p.vx_samples, scratch.sampled_vx)
    change = p.acc_lim_y * period
    vy_count = _fill_window(p.min_vel_y, max_vy, start.vy, change, p.vy_samples, scratch.sampled_vy)
    # As in C++, min_vel_theta does not bound the window: turns go both ways.
    max_w = p.max_vel_theta
    change = p.acc_lim_theta * period
    w_count = _fill_window(-max_w, max_w, start.w, change, p.vth_samples, scratch.sampled_w)
    return SampleCounts(vx_count, vy_count, w_count)


@kernel(inline="always")
def sample_of(scratch: DWAScratch, axis_counts: SampleCounts, number: int) -> Velocity:
    """Return the sample with this number."""
    vx = scratch.sampled_vx[number // (axis_counts.w * axis_counts.vy)]
    vy = scratch.sampled_vy[number // axis_counts.w % axis_counts.vy]
    return Velocity(vx, vy, scratch.sampled_w[number % axis_counts.w])


@kernel
def _fill_window(
    lowest: float, highest: float, velocity: float, change: float, n: float, values: Data
) -> int:
    """Fill the n sampled values of one axis and return their number, see `spread`.

    The values lie within the limits of the axis, and at most `change` away from `velocity`.
    """
    bottom = single(max(lowest, velocity - change))
    top = single(min(highest, velocity + change))
    return spread(bottom, top, n, values)


@kernel
def spread(bottom: float, top: float, n: float, values: Data) -> int:
    """Fill `values` from bottom to top in n - 1 equal steps, and return the number of values.

    The values come from repeated addition, each rounded to float32 (velocity_iterator.h). A zero is
    added between values of different signs. There is one value if bottom equals top, otherwise
    there are at least two. The values descend if bottom is above top.
    """
    # A window without width has one value, whatever the number of samples.
    if bottom == top:
        values[0] = bottom
        return 1
    n = max(int(n), 2)
    step = (top - bottom) / (n - 1)
    next_velocity = bottom
    value_count = 0
    for _ in range(n - 1):
        velocity = next_velocity
        next_velocity += step
        values[value_count] = single(velocity)
        value_count += 1
        if velocity < 0 and next_velocity > 0:
            values[value_count] = 0.0
            value_count += 1
    values[value_count] = single(top)
    return value_count + 1


@kernel
def ground_speed(vx: float, vy: float) -> float:
    """Return the speed over ground [m/s]."""
    # This equals hypot and takes a fraction of its time.
    if vy == 0.0:
        return abs(vx)
    return math.hypot(vx, vy)


@kernel
def is_too_fast(p: Record, speed: float) -> bool:
    """Return whether samples of this speed over ground are rejected."""
    return p.max_vel_trans >= 0 and speed - SLACK > p.max_vel_trans


@kernel
def slowest_turn(p: Record, speed: float) -> float:
    """Return the minimum turn rate [rad/s] of samples at this speed, or -1 if none applies."""
    is_slow = p.min_vel_trans >= 0 and speed + SLACK < p.min_vel_trans
    if is_slow and p.min_vel_theta >= 0:
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
def step_count(p: Record, sample: Velocity) -> int:
    """Return the number of steps of a sample's trajectory, or 0 to reject the sample."""
    speed = ground_speed(sample.vx, sample.vy)
    if is_too_fast(p, speed) or abs(sample.w) + SLACK < slowest_turn(p, speed):
        return 0
    return int(math.ceil(max(linear_steps(p, speed), angular_steps(p, sample.w))))


@kernel
def ramp(target: float, velocity: float, change: float) -> float:
    """Return the velocity moved towards `target` by at most `change`."""
    if velocity < target:
        return single(min(target, velocity + change))
    return single(max(target, velocity - change))


@kernel
def ramped(p: Record, sample: Velocity, velocity: Velocity, dt: float) -> Velocity:
    """Return the velocity after dt [s] of acceleration from `velocity` towards the sample."""
    vx = ramp(sample.vx, velocity.vx, p.acc_lim_x * dt)
    vy = ramp(sample.vy, velocity.vy, p.acc_lim_y * dt)
    w = ramp(sample.w, velocity.w, p.acc_lim_theta * dt)
    return Velocity(vx, vy, w)


@kernel
def commanded(p: Record, start: Record, sample: Velocity, steps: int) -> Velocity:
    """Return the velocity that a sample's trajectory stores and commands.

    With use_dwa this is the sample, otherwise the measured velocity after the first step of the
    ramp.
    """
    if p.use_dwa:
        return sample
    return ramped(p, sample, Velocity(start.vx, start.vy, start.w), p.sim_time / steps)


@kernel
def move(
    x: float, y: float, theta: float, velocity: Velocity, dt: float
) -> Tuple[float, float, float]:
    """Return the pose (x, y, theta) after dt [s], each rounded to float32."""
    cos = math.cos(theta)
    sin = math.sin(theta)
    vx = velocity.vx
    vy = velocity.vy
    following_theta = single(theta + velocity.w * dt)
    # Without a sideways speed, the terms below would add zeros.
    if vy == 0.0:
        return single(x + vx * cos * dt), single(y + vx * sin * dt), following_theta
    side_angle = math.pi / 2 + theta
    dx = (vx * cos + vy * math.cos(side_angle)) * dt
    dy = (vx * sin + vy * math.sin(side_angle)) * dt
    return single(x + dx), single(y + dy), following_theta


@kernel
def roll_out(p: Record, start: Record, sample: Velocity, points: Data) -> None:
    """Write the poses x, y, theta before each step to `points` (steps, 3), the current pose first.

    The last pose that C++ integrates is not stored. Without use_dwa the velocity is ramped before
    every move, the first included, so the first move is already two ramps away from the measured
    velocity.
    """
    steps = points.shape[0]
    if steps == 0:
        return
    dt = p.sim_time / steps
    x = start.x
    y = start.y
    theta = start.theta
    velocity = commanded(p, start, sample, steps)
    for i in range(steps):
        points[i, 0] = x
        points[i, 1] = y
        points[i, 2] = theta
        if not p.use_dwa:
            velocity = ramped(p, sample, velocity, dt)
        x, y, theta = move(x, y, theta, velocity, dt)
