"""Driven wheels of both simulators: velocity controller, wheel speeds, friction on the ground.

Bullet's own friction between wheels and ground is not used. It acts along the world's axes, so a
turn in place runs at .9 to 1.3 of the commanded rate depending on the heading (.2 to 1.0 with
Bullet's friction cone). There are two friction models instead, named grounds. On ground `plain`,
Coulomb's force on each tyre opposes the slip in any direction. Ground `gazebo` reproduces the
friction of the Jackal in Gazebo (`_pyramid`), which varies with the wheels' angles.

On plain ground, the wheels of a skid-steered robot that turns in place must run faster than w *
track / 2 by the factor 1 + (wheel base / track)^2. It is 1.49 for the Jackal (Clearpath's
separation multiplier is 1.5) and smaller in a fast curve. `rim_table` has the factor of every (v,
w). The Jackal's centre of mass lies ahead of the wheels' centre, so the front wheels slip less, and
the robot turns about a point ahead of base_link: base_link drifts in a turn in place. Two
driven wheels need no factor, and casters slide with their own friction.

Kernels share these arguments:
    vehicle: Record of Vehicle.
    supports: Records (n,) of mechanics.Support.
    table: rim_table().
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import cos, exp, pi, sin, sqrt
from typing import Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Twist
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.robots import Robot

from .mechanics import LEFT_SIDE, RIGHT_SIDE, STEP, TABLE_INTERVALS, Constants, mechanics
from .records import Records, record

# Components along the axes, or velocity: forward, leftward, turn rate
Vector = Tuple[float, float, float]
SIDES = 2  # number of the wheels' speed noises, left and right
_KEEP_PULL = exp(-STEP / 0.02)  # decay of the filtered acceleration in a step; time constant 20 ms
_JAM_SHARE = 0.1  # smallest ratio of a wheel's load to its contact force on Gazebo's ground
_STICK_M_S = 0.01  # slip speed below which Gazebo's friction is less than its full force [m/s]
_SETTLING_STEPS = 1200  # steps of a drive of _settle, 5 s
_SETTLING_GAIN = 0.02  # correction of the rim speeds per step and error of the body's speed


@dataclass
class Drivetrain:
    """State of the velocity controller and the wheels."""

    ramp_v: float = 0.0  # command within the acceleration limits [m/s]
    ramp_w: float = 0.0  # [rad/s]
    left_rim: float = 0.0  # rim speed of the left wheels [m/s]
    right_rim: float = 0.0
    pull_x: float = 0.0  # filtered acceleration of the body by the tyres, forward [m/s^2]
    pull_y: float = 0.0  # leftward [m/s^2]
    left_angle: float = 0.0  # angle of the left wheels [rad]
    right_angle: float = 0.0
    left_noise: float = 0.0  # noise of the left wheels' speed, of standard deviation Surface.slip
    right_noise: float = 0.0


@dataclass
class Surface:
    """Ground of one drive."""

    slip: float  # factor on all random errors
    friction: float  # friction coefficient of the driven wheels
    ground: float  # 0: plain ground, 1: Gazebo's; values in between blend both


@dataclass
class Vehicle:
    """One robot on its ground."""

    constants: Constants
    surface: Surface
    drivetrain: Drivetrain


def new_vehicle(constants: Constants, surface: Surface, seed: Sequence[int]) -> Records:
    """Return the record (1,) of a vehicle at rest, with wheel angles drawn from the seed."""
    left, right = np.random.default_rng(seed).uniform(0.0, 2.0 * pi, SIDES)
    return record(Vehicle(constants, surface, Drivetrain(left_angle=left, right_angle=right)))


def noises(supports: Records) -> int:
    """Return the number of random numbers per step, one for each side and for each support."""
    return SIDES + len(supports)


@kernel(error_model="numpy", forceinline=True)
def turn_wheels(
    vehicle: Vehicle, supports: Records, command: Twist, table: Array, noise: Array
) -> None:
    """Run one step of the velocity controller, which ramps towards `command` (v, w) [m/s, rad/s].

    Sets the rim speeds of the drivetrain. The random numbers `noise` (noises(),) are standard
    normal. Gazebo's controller has a constant multiplier of the track instead of the table, and
    Gazebo's wheels have no noise.
    """
    constants = vehicle.constants
    surface = vehicle.surface
    drivetrain = vehicle.drivetrain
    v, w = command
    # The ramp of the controller, also for a stop: a robot does not brake harder than it
    # accelerates.
    v_step = constants.acceleration * STEP
    drivetrain.ramp_v = min(max(v, drivetrain.ramp_v - v_step), drivetrain.ramp_v + v_step)
    w_step = constants.yaw_acceleration * STEP
    drivetrain.ramp_w = min(max(w, drivetrain.ramp_w - w_step), drivetrain.ramp_w + w_step)

    # Noise of first order, whose standard deviation does not depend on the length of a step
    keep = constants.keep_wheel
    draw = constants.draw_wheel * surface.slip
    drivetrain.left_noise = keep * drivetrain.left_noise + draw * noise[0]
    drivetrain.right_noise = keep * drivetrain.right_noise + draw * noise[1]
    keep = constants.keep_grip
    draw = constants.draw_grip * surface.slip
    for row in range(supports.shape[0]):
        supports[row].grip_noise = keep * supports[row].grip_noise + draw * noise[SIDES + row]

    mean_speed, half_difference = _rims(drivetrain.ramp_v, drivetrain.ramp_w, table, constants)
    shake = 0.0  # Wheels at rest do not shake.
    if drivetrain.ramp_v != 0.0 or drivetrain.ramp_w != 0.0:
        shake = constants.wheel_shake
    relative_noise = constants.wheel_noise
    ground = surface.ground
    if ground > 0.0:
        # Gazebo's diff_drive_controller knows nothing of slip: it multiplies the track by a
        # constant.
        half_track = 0.5 * constants.track * constants.track_multiplier
        mean_speed += ground * (drivetrain.ramp_v - mean_speed)
        half_difference += ground * (half_track * drivetrain.ramp_w - half_difference)
        shake *= 1.0 - ground
        relative_noise *= 1.0 - ground
    # Noise grows with a side's own speed, so that a turn in place is as uneven as a drive.
    left = mean_speed - half_difference
    right = mean_speed + half_difference
    drivetrain.left_rim = left + (shake + relative_noise * abs(left)) * drivetrain.left_noise
    drivetrain.right_rim = right + (shake + relative_noise * abs(right)) * drivetrain.right_noise
    drivetrain.left_angle += STEP / constants.wheel_radius * drivetrain.left_rim
    drivetrain.right_angle += STEP / constants.wheel_radius * drivetrain.right_rim


@kernel
def _rims(v: float, w: float, table: Array, constants: Constants) -> Tuple[float, float]:
    """Return the mean and half the difference of the rim speeds [m/s] for (v, w).

    A command beyond the table takes its last entries.
    """
    row = min(abs(v) * constants.intervals_per_speed, table.shape[0] - 1.001)
    column = min(abs(w) * constants.intervals_per_turn, table.shape[1] - 1.001)
    addition = _interpolated(table, row, column, 0)
    multiplier = _interpolated(table, row, column, 1)
    if v <= 0.0:  # The table holds forward speeds.
        addition = -addition
    return v + addition, 0.5 * constants.track * w * multiplier


@kernel
def _interpolated(table: Array, row: float, column: float, entry: int) -> float:
    """Return an entry of the table at (row, column), bilinearly interpolated."""
    first_row = int(row)
    first_column = int(column)
    # Each weight is the area of the rectangle opposite its entry.
    row -= first_row
    column -= first_column
    weight_00 = (1.0 - row) * (1.0 - column)
    weight_01 = (1.0 - row) * column
    weight_10 = row * (1.0 - column)
    weight_11 = row * column
    interpolated: float = (
        weight_00 * table[first_row, first_column, entry]
        + weight_01 * table[first_row, first_column + 1, entry]
        + weight_10 * table[first_row + 1, first_column, entry]
        + weight_11 * table[first_row + 1, first_column + 1, entry]
    )
    return interpolated


@kernel(error_model="numpy", forceinline=True)
def tyres(vehicle: Vehicle, supports: Records, velocity: Vector) -> Vector:
    """Return the change of the body's velocity by tyres and casters in one step.

    Coulomb friction is smoothed below the tyres' creep speed, and solved implicitly for the
    velocity at the end of the step in two passes. The solution is stable and keeps a robot at rest.
    Acceleration transfers load between supports.

    `velocity` is the forward and leftward velocity of the centre of mass [m/s], and the yaw rate
    [rad/s].
    """
    if supports.shape[0] == 4:  # A constant count lets the compiler unroll the loop.
        return _tyres(4, vehicle, supports, velocity)
    return _tyres(supports.shape[0], vehicle, supports, velocity)


@kernel(inline="always", error_model="numpy")
def _tyres(n: int, vehicle: Vehicle, supports: Records, velocity: Vector) -> Vector:
    """Return the result of tyres() for `n` supports.

    The unknown is the change d of the velocity. With drag = step * force / slip [kg] of each
    support, and J the derivative of its slip by the velocity, the change of momentum is M d = -sum
    drag J' (slip + J d). The kernel sums M + drag J'J in `matrix_*` and -drag J' slip in
    `impulse_*`, whose letters v, s, w stand for forward, leftward and yaw rate.
    """
    constants = vehicle.constants
    drivetrain = vehicle.drivetrain
    friction = vehicle.surface.friction
    ground = vehicle.surface.ground
    forward, leftward, yaw_rate = velocity
    mass = constants.mass
    creep = constants.tyre_creep
    # Acceleration at the height of the centre of mass tips the robot: moments over the levers of
    # the supports.
    tip_x = drivetrain.pull_x * mass * constants.com_height / constants.lever_x
    tip_y = drivetrain.pull_y * mass * constants.com_height / constants.lever_y
    left_cos = cos(drivetrain.left_angle)
    left_sin = sin(drivetrain.left_angle)
    right_cos = cos(drivetrain.right_angle)
    right_sin = sin(drivetrain.right_angle)
    forward_change = 0.0
    leftward_change = 0.0
    yaw_rate_change = 0.0
    for _ in range(2):  # The second pass takes the forces at the slip that the first one has found.
        matrix_vv = mass
        matrix_ss = mass
        matrix_ww = constants.yaw_inertia
        matrix_vw = 0.0
        matrix_sw = 0.0
        impulse_v = 0.0
        impulse_s = 0.0
        impulse_w = 0.0
        for row in range(n):
            support = supports[row]
            x = support.x
            y = support.y
            rim = 0.0  # rim speed of a caster
            wheel_cos = right_cos
            wheel_sin = right_sin
            if support.side == LEFT_SIDE:
                rim = drivetrain.left_rim
                wheel_cos = left_cos
                wheel_sin = left_sin
            elif support.side == RIGHT_SIDE:
                rim = drivetrain.right_rim
            load = support.load + support.shift_x * tip_x + support.shift_y * tip_y

            # Gazebo's ground: the wheel stands on both edges of its rim.
            if ground > 0.0:
                pressure = ground * friction * max(load, 0.0) * support.lift
                for edge in (-0.5, 0.5):
                    edge_y = y + edge * constants.wheel_width
                    # Lateral acceleration shifts the load to the outer edge.
                    outer = 0.5 - 2.0 * edge * constants.edge_shift * drivetrain.pull_y
                    share = min(max(outer, 0.0), 1.0)
                    slip_x = forward - yaw_rate * edge_y - rim
                    slip_y = leftward + yaw_rate * x
                    end_slip_x = slip_x + forward_change - yaw_rate_change * edge_y
                    end_slip_y = slip_y + leftward_change + yaw_rate_change * x
                    drag_x, drag_y = _pyramid(
                        end_slip_x, end_slip_y, wheel_cos, wheel_sin, friction
                    )
                    drag_x *= STEP * pressure * share
                    drag_y *= STEP * pressure * share
                    matrix_vv += drag_x
                    matrix_ss += drag_y
                    matrix_ww += drag_x * edge_y * edge_y + drag_y * x * x
                    matrix_vw -= drag_x * edge_y
                    matrix_sw += drag_y * x
                    impulse_v -= drag_x * slip_x
                    impulse_s -= drag_y * slip_y
                    impulse_w -= drag_y * x * slip_y - drag_x * edge_y * slip_x
                if ground >= 1.0:
                    continue

            # Plain ground: the force opposes the slip at the end of the step.
            slip_x = forward - yaw_rate * y - rim
            slip_y = leftward + yaw_rate * x
            end_slip_x = slip_x + forward_change - yaw_rate_change * y
            end_slip_y = slip_y + leftward_change + yaw_rate_change * x
            noisy_friction = friction * max(0.0, 1.0 + support.grip_noise)
            grip = noisy_friction * max(load, 0.0) * support.lift * support.friction_share
            if ground > 0.0:
                grip *= 1.0 - ground
            # The creep speed keeps the drag finite at rest: below it, the force falls with the
            # slip.
            slip2 = end_slip_x * end_slip_x + end_slip_y * end_slip_y + creep * creep
            drag = STEP * grip / sqrt(slip2)
            matrix_vv += drag
            matrix_ss += drag
            matrix_ww += drag * (x * x + y * y)
            matrix_vw -= drag * y
            matrix_sw += drag * x
            impulse_v -= drag * slip_x
            impulse_s -= drag * slip_y
            impulse_w -= drag * (x * slip_y - y * slip_x)

        # Forward and leftward velocity are coupled only through the yaw rate, which is solved
        # first.
        remaining = (
            impulse_w - matrix_vw * impulse_v / matrix_vv - matrix_sw * impulse_s / matrix_ss
        )
        inertia = matrix_ww - matrix_vw * matrix_vw / matrix_vv - matrix_sw * matrix_sw / matrix_ss
        yaw_rate_change = remaining / inertia
        forward_change = (impulse_v - matrix_vw * yaw_rate_change) / matrix_vv
        leftward_change = (impulse_s - matrix_sw * yaw_rate_change) / matrix_ss
    # The filtered acceleration tips the robot in the next step. Without the filter, load and
    # friction would excite each other.
    drivetrain.pull_x = _KEEP_PULL * drivetrain.pull_x + (1.0 - _KEEP_PULL) * forward_change / STEP
    drivetrain.pull_y = _KEEP_PULL * drivetrain.pull_y + (1.0 - _KEEP_PULL) * leftward_change / STEP
    return forward_change, leftward_change, yaw_rate_change


@kernel(error_model="numpy")
def _pyramid(
    slip_x: float, slip_y: float, wheel_cos: float, wheel_sin: float, friction: float
) -> Tuple[float, float]:
    """Return the friction forces (forward, sideways) of a wheel's edge in Gazebo.

    They are relative to slip speed * friction * load [s/m].

    The Jackal's URDF gives `fdir1 = 1 0 0`, which turns with the wheel, whose angle has the cosine
    `wheel_cos` and the sine `wheel_sin`. ODE uses this vector as the first direction of its
    friction pyramid without projecting it onto the ground. The horizontal part of both directions
    has the length |wheel_cos|. The vertical part of the first force presses the wheel down or lifts
    it. With a friction coefficient of 1 or more, the contact force would grow without limit, so
    _JAM_SHARE limits it.
    """
    # Below _STICK_M_S, the force is proportional to the slip: a wheel at rest does not jitter.
    along = slip_x * wheel_cos
    speed_x = max(abs(along), _STICK_M_S)
    speed_y = max(abs(slip_y * wheel_cos), _STICK_M_S)
    pressure = 1.0 / max(1.0 + friction * along / speed_x * wheel_sin, _JAM_SHARE)
    horizontal = pressure * wheel_cos * wheel_cos
    return horizontal / speed_x, horizontal / speed_y


@lru_cache(maxsize=64)
def rim_table(robot: Robot) -> Array:
    """Return the table (17, 17, 2) of rim speeds that realise a command on even, plain ground.

    The entry in row i and column j holds the addition to the speed and the multiplier of the track,
    for i/16 of the maximum speed and j/16 of the maximum yaw rate. Curves beyond the tyres'
    friction limit (v w above grip_limit) take the multiplier of the tightest feasible curve at that
    speed. The table is computed by simulated driving in about 50 ms.
    """
    base = robot.base
    robot_mechanics = mechanics(robot)
    v_step = base.max_speed / TABLE_INTERVALS
    w_step = base.max_yaw_rate / TABLE_INTERVALS
    even = Surface(slip=0.0, friction=base.wheel_friction, ground=0.0)
    entries = TABLE_INTERVALS + 1
    table = np.zeros((entries, entries, 2))
    for row in range(entries):
        for column in range(entries):
            v = row * v_step
            # The multiplier of a straight drive is that of a small yaw rate.
            w = max(column, 1e-3) * w_step
            # Beyond the friction limit, no rim speed would make the body follow.
            if v * w > robot.simulation.grip_limit:
                table[row, column] = table[row, column - 1]
                continue
            vehicle = record(Vehicle(robot_mechanics.constants, even, Drivetrain()))
            table[row, column] = _settle(v, w, vehicle, robot_mechanics.supports)
    return table


@kernel
def _settle(v: float, w: float, vehicles: Records, supports: Records) -> Tuple[float, float]:
    """Return the addition to v and the multiplier of the track with which the body drives (v, w).

    The rim speeds are adjusted in a simulated drive until the body follows the command.
    `vehicles` is the record (1,) of a Vehicle.
    """
    vehicle: Vehicle = vehicles[0]
    constants = vehicle.constants
    drivetrain = vehicle.drivetrain
    half_track = 0.5 * constants.track
    mean_speed = v
    # The search begins with a multiplier between those of two and of four driven wheels.
    half_difference = 1.3 * half_track * w
    forward = v + w * constants.com_y
    leftward = w * constants.com_x
    yaw_rate = w
    for _ in range(_SETTLING_STEPS):
        drivetrain.left_rim = mean_speed - half_difference
        drivetrain.right_rim = mean_speed + half_difference
        change = tyres(vehicle, supports, (forward, leftward, yaw_rate))
        forward += change[0]
        leftward += change[1]
        yaw_rate += change[2]
        # The axes of the body turn under its velocity.
        cos_turn = cos(yaw_rate * STEP)
        sin_turn = sin(yaw_rate * STEP)
        ahead = cos_turn * forward + sin_turn * leftward
        leftward = cos_turn * leftward - sin_turn * forward
        forward = ahead
        mean_speed += _SETTLING_GAIN * (v - forward - yaw_rate * constants.com_y)
        half_difference += _SETTLING_GAIN * half_track * (w - yaw_rate)
    addition = 0.0
    if v > 0.0:
        addition = mean_speed - v
    return addition, half_difference / (half_track * w)
