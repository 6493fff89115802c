"""Driven wheels of both simulators: velocity controller, wheel speeds, friction of tyres and casters on the ground.

Bullet's own friction between wheels and ground is not used. It acts along the world's axes, so a turn in place runs at
.9 to 1.3 of the commanded rate depending on the heading (.2 to 1.0 with Bullet's friction cone). There are two friction
models instead, named grounds. On ground `plain`, Coulomb's force on each tyre opposes the slip in any direction. Ground
`gazebo` reproduces the friction of the Jackal in Gazebo (`_pyramid`), which varies with the wheels' angles.

On plain ground, the wheels of a skid-steered robot that turns in place must run faster than w * track / 2 by the factor
1 + (wheel base / track)^2. It is 1.49 for the Jackal (Clearpath's separation multiplier is 1.5) and smaller in a fast
curve. `rim_table` has the factor of every (v, w). The Jackal's centre of mass lies ahead of the wheels' centre, so the
front wheels slip less, and the robot turns about a point ahead of base_link: base_link drifts in a turn in place. Two
driven wheels need no factor, and casters slide with their own friction.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, exp, pi, sin, sqrt
from typing import Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.robots import Robot

from . import mechanics as m
from .mechanics import STEP

Triple = Tuple[float, float, float]
# Indices of the drivetrain's state `drive`: ramped command [m/s, rad/s], rim speeds [m/s], filtered acceleration of the
# body by the tyres [m/s^2], angles of the left and right wheels [rad], noise of each side, noise of each support.
# Other arguments of the kernels: table: rim_table(). scalars, supports: arrays of Mechanics. slip: factor on all random
# errors. friction: coefficient of the wheels. ground: 0 for plain ground, 1 for Gazebo's; values in between blend both.
RAMP_V, RAMP_W, LEFT, RIGHT, PULL_X, PULL_Y, ANGLE, WHEEL_NOISE, GRIP_NOISE = 0, 1, 2, 3, 4, 5, 6, 8, 10
_KEEP_PULL = exp(-STEP / 0.02)  # decay per step of the filtered acceleration, whose time constant is 20 ms
_JAM_SHARE = 0.1  # smallest ratio of a wheel's load to its contact force on Gazebo's ground
_STICK_M_S = 0.01  # slip speed below which Gazebo's friction is less than its full force [m/s]


def new_drive(supports: Array, seed: Sequence[int]) -> Array:
    """Return the drivetrain's state at rest. The angles of the wheels are drawn from the seed."""
    drive = np.zeros(GRIP_NOISE + len(supports))
    drive[ANGLE : ANGLE + 2] = np.random.default_rng(seed).uniform(0.0, 2.0 * pi, 2)
    return drive


def noises(supports: Array) -> int:
    """Return the number of normal random numbers per step, one for each side and one for each support."""
    return 2 + len(supports)


@kernel(error_model="numpy", forceinline=True)
def turn_wheels(
    drive: Array, v: float, w: float, table: Array, scalars: Array, noise: Array, slip: float, ground: float
) -> None:
    """Run one step of the velocity controller towards (v, w) [m/s, rad/s] within its acceleration limits.

    Sets the rim speeds drive[LEFT], drive[RIGHT] [m/s]. The random numbers `noise` (noises(),) are standard normal.
    Gazebo's controller has a constant multiplier of the track instead of the table, and Gazebo's wheels have no noise.
    """
    rate = scalars[m.ACCELERATION] * STEP
    drive[RAMP_V] = min(max(v, drive[RAMP_V] - rate), drive[RAMP_V] + rate)
    rate = scalars[m.YAW_ACCELERATION] * STEP
    drive[RAMP_W] = min(max(w, drive[RAMP_W] - rate), drive[RAMP_W] + rate)
    keep = scalars[m.KEEP_WHEEL]
    shake = scalars[m.DRAW_WHEEL] * slip
    for i in range(2):
        drive[WHEEL_NOISE + i] = keep * drive[WHEEL_NOISE + i] + shake * noise[i]
    keep = scalars[m.KEEP_GRIP]
    shake = scalars[m.DRAW_GRIP] * slip
    for i in range(noise.shape[0] - 2):
        drive[GRIP_NOISE + i] = keep * drive[GRIP_NOISE + i] + shake * noise[2 + i]
    ahead, side = _rims(drive[RAMP_V], drive[RAMP_W], table, scalars)
    moving = scalars[m.WHEEL_SHAKE] if drive[RAMP_V] != 0.0 or drive[RAMP_W] != 0.0 else 0.0
    uneven = scalars[m.WHEEL_NOISE]
    if ground > 0.0:
        ahead += ground * (drive[RAMP_V] - ahead)
        side += ground * (0.5 * scalars[m.TRACK] * scalars[m.TRACK_MULTIPLIER] * drive[RAMP_W] - side)
        moving *= 1.0 - ground
        uneven *= 1.0 - ground
    drive[LEFT] = ahead - side + (moving + uneven * abs(ahead - side)) * drive[WHEEL_NOISE]
    drive[RIGHT] = ahead + side + (moving + uneven * abs(ahead + side)) * drive[WHEEL_NOISE + 1]
    for i in range(2):
        drive[ANGLE + i] += STEP / scalars[m.WHEEL_RADIUS] * drive[LEFT + i]


@kernel
def _rims(v: float, w: float, table: Array, scalars: Array) -> Tuple[float, float]:
    """Return the mean and half the difference of the rim speeds for (v, w), bilinearly interpolated in the table."""
    sign = 1.0 if v > 0.0 else -1.0
    a = min(abs(v) * scalars[m.PER_V], table.shape[0] - 1.001)
    b = min(abs(w) * scalars[m.PER_W], table.shape[1] - 1.001)
    i, j = int(a), int(b)
    a, b = a - i, b - j
    p, q, r, t = (1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b
    more = p * table[i, j, 0] + q * table[i, j + 1, 0] + r * table[i + 1, j, 0] + t * table[i + 1, j + 1, 0]
    spread = p * table[i, j, 1] + q * table[i, j + 1, 1] + r * table[i + 1, j, 1] + t * table[i + 1, j + 1, 1]
    return v + sign * more, 0.5 * scalars[m.TRACK] * w * spread


@kernel(error_model="numpy", forceinline=True)
def tyres(
    drive: Array, twist: Triple, scalars: Array, supports: Array, friction: float, lift: Array, ground: float
) -> Triple:
    """Return the change (du, ds, dw) of the body's velocity by tyres and casters in one step.

    Coulomb friction is smoothed below the tyres' creep speed, and solved implicitly for the velocity at the end of the
    step in two passes. The solution is stable and keeps a robot at rest. Acceleration transfers load between supports.

    `twist` is the forward and leftward velocity of the centre of mass [m/s], and the yaw rate [rad/s]. `lift` (n,) is
    the share of its load that each support carries: 1 with full contact, 0 off the ground.
    """
    if supports.shape[0] == 4:  # A constant count lets the compiler unroll the loop.
        return _tyres(4, drive, twist, scalars, supports, friction, lift, ground)
    return _tyres(supports.shape[0], drive, twist, scalars, supports, friction, lift, ground)


@kernel(inline="always", error_model="numpy")
def _tyres(
    n: int, drive: Array, twist: Triple, scalars: Array, supports: Array, friction: float, lift: Array, ground: float
) -> Triple:
    u, s, w = twist
    mass, inertia, creep = scalars[m.MASS], scalars[m.YAW_INERTIA], scalars[m.TYRE_CREEP]
    tip_x = drive[PULL_X] * mass * scalars[m.COM_HEIGHT] / scalars[m.LEVER_X]
    tip_y = drive[PULL_Y] * mass * scalars[m.COM_HEIGHT] / scalars[m.LEVER_Y]
    left, right = drive[ANGLE], drive[ANGLE + 1]
    turned = ((cos(left), sin(left)), (cos(right), sin(right)))
    du, ds, dw = 0.0, 0.0, 0.0
    for _ in range(2):
        # Solve (M + sum k J'J) d = -sum k J' slip for d = (du, ds, dw), with k = step * force / slip of each support.
        a00, a11, a22, a02, a12 = mass, mass, inertia, 0.0, 0.0
        b0, b1, b2 = 0.0, 0.0, 0.0
        for i in range(n):
            side = supports[i, m.SIDE]
            rim = drive[LEFT] if side == m.LEFT_SIDE else (drive[RIGHT] if side == m.RIGHT_SIDE else 0.0)
            x, y = supports[i, m.X], supports[i, m.Y]
            slip_x, slip_y = u - w * y - rim, s + w * x
            end_x, end_y = slip_x + du - dw * y, slip_y + ds + dw * x
            load = supports[i, m.LOAD] + supports[i, m.SHIFT_X] * tip_x + supports[i, m.SHIFT_Y] * tip_y
            if ground > 0.0:
                c, sn = turned[int(side)]
                press = ground * friction * max(load, 0.0) * lift[i]
                for edge in (-0.5, 0.5):
                    at_y = y + edge * scalars[m.WHEEL_WIDTH]
                    share = min(max(0.5 - 2.0 * edge * scalars[m.EDGE_SHIFT] * drive[PULL_Y], 0.0), 1.0)
                    slip_x, slip_y = u - w * at_y - rim, s + w * x
                    end_x, end_y = slip_x + du - dw * at_y, slip_y + ds + dw * x
                    kx, ky = _pyramid(end_x, end_y, c, sn, friction)
                    kx *= STEP * press * share
                    ky *= STEP * press * share
                    a00 += kx
                    a11 += ky
                    a22 += kx * at_y * at_y + ky * x * x
                    a02 -= kx * at_y
                    a12 += ky * x
                    b0 -= kx * slip_x
                    b1 -= ky * slip_y
                    b2 -= ky * x * slip_y - kx * at_y * slip_x
                if ground >= 1.0:
                    continue
            grip = friction * max(0.0, 1.0 + drive[GRIP_NOISE + i]) * max(load, 0.0) * lift[i] * supports[i, m.SHARE]
            if ground > 0.0:
                grip *= 1.0 - ground
                slip_x, slip_y = u - w * y - rim, s + w * x
                end_x, end_y = slip_x + du - dw * y, slip_y + ds + dw * x
            k = STEP * grip / sqrt(end_x * end_x + end_y * end_y + creep * creep)
            a00 += k
            a11 += k
            a22 += k * (x * x + y * y)
            a02 -= k * y
            a12 += k * x
            b0 -= k * slip_x
            b1 -= k * slip_y
            b2 -= k * (x * slip_y - y * slip_x)
        dw = (b2 - a02 * b0 / a00 - a12 * b1 / a11) / (a22 - a02 * a02 / a00 - a12 * a12 / a11)
        du = (b0 - a02 * dw) / a00
        ds = (b1 - a12 * dw) / a11
    drive[PULL_X] = _KEEP_PULL * drive[PULL_X] + (1.0 - _KEEP_PULL) * du / STEP
    drive[PULL_Y] = _KEEP_PULL * drive[PULL_Y] + (1.0 - _KEEP_PULL) * ds / STEP
    return du, ds, dw


@kernel(error_model="numpy")
def _pyramid(slip_x: float, slip_y: float, c: float, sn: float, friction: float) -> Tuple[float, float]:
    """Return a wheel edge's friction forces (forward, sideways) / (slip speed * friction * load) in Gazebo [s/m].

    The Jackal's URDF gives `fdir1 = 1 0 0`, which turns with the wheel (angle with cosine c and sine sn). ODE uses this
    vector as the first direction of its friction pyramid without projecting it onto the ground. The horizontal part of
    both directions has the length |c|. The vertical part of the first force presses the wheel down or lifts it. With a
    friction coefficient of 1 or more, the contact force would grow without limit, so _JAM_SHARE limits it.
    """
    ahead = slip_x * c
    over_x, over_y = max(abs(ahead), _STICK_M_S), max(abs(slip_y * c), _STICK_M_S)
    press = 1.0 / max(1.0 + friction * ahead / over_x * sn, _JAM_SHARE)
    return press * c * c / over_x, press * c * c / over_y


@lru_cache(maxsize=64)
def rim_table(robot: Robot) -> Array:
    """Return the table (17, 17, 2) of rim speeds that realise a command on nominal, even, plain ground.

    Entry (i, j) holds the addition to the speed and the multiplier of the track for i/16 of the maximum speed and j/16
    of the maximum yaw rate. Curves beyond the tyres' friction limit (v w above grip_limit) take the multiplier of the
    tightest feasible curve at that speed. The table is computed by simulated driving in about 50 ms.
    """
    base, mechanics = robot.base, m.mechanics(robot)
    v_step, w_step = base.max_speed / m.TABLE, base.max_yaw_rate / m.TABLE
    table = np.zeros((m.TABLE + 1, m.TABLE + 1, 2))
    for i in range(m.TABLE + 1):
        for j in range(m.TABLE + 1):
            v, w = i * v_step, max(j, 1e-3) * w_step
            if v * w > robot.simulation.grip_limit:
                table[i, j] = table[i, j - 1]
            else:
                table[i, j] = _settle(v, w, mechanics.scalars, mechanics.supports, base.wheel_friction)
    return table


@kernel
def _settle(v: float, w: float, scalars: Array, supports: Array, friction: float) -> Tuple[float, float]:
    """Simulate (v, w), adjust the rim speeds until the body follows, and return (addition to v, track multiplier)."""
    drive, lift = np.zeros(GRIP_NOISE + supports.shape[0]), np.ones(supports.shape[0])
    half = 0.5 * scalars[m.TRACK]
    ahead, side = v, 1.3 * half * w
    u, s, turn = v + w * scalars[m.COM_Y], w * scalars[m.COM_X], w
    for _ in range(1200):
        drive[LEFT], drive[RIGHT] = ahead - side, ahead + side
        du, ds, dw = tyres(drive, (u, s, turn), scalars, supports, friction, lift, 0.0)
        u, s, turn = u + du, s + ds, turn + dw
        c, sn = cos(turn * STEP), sin(turn * STEP)
        u, s = c * u + sn * s, c * s - sn * u
        ahead += 0.02 * (v - u - turn * scalars[m.COM_Y])
        side += 0.02 * half * (w - turn)
    return (ahead - v if v > 0.0 else 0.0), side / (half * w)
