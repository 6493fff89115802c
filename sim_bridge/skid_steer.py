"""How a robot with four skid-steered wheels moves: velocity controller, wheel speeds, friction of the tyres.

Both simulators call it every physics step, so both drive alike. Bullet's own friction is not used between wheels and
ground: it is laid along the world's axes, which makes a turn in place run at .9 to 1.3 of the commanded rate depending
on the heading (its cone variant: .2 to 1.0). Here each tyre pulls against its slip with Coulomb's force, in any
direction.

With forces opposed to slip a turn in place needs wheels faster than the turning body by 1 + (wheel base / track)^2 =
1.49 (Clearpath's separation multiplier: 1.5), less when a fast curve presses the robot outwards: `rim_table` holds what
every (v, w) needs. The centre of mass lies ahead of the wheels' middle, so the front grips better and the robot turns
about a point ahead of base_link: the drift of a turn in place.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, exp, sin, sqrt

import numpy as np

from applr_ros1.common.kernels import kernel

from . import jackal

STEP = 1.0 / 240.0  # both simulators' physics step [s]
# the drive's own state
RAMP_V, RAMP_W, LEFT, RIGHT, PULL_X, PULL_Y, WHEEL_NOISE, GRIP_NOISE, SIZE = 0, 1, 2, 3, 4, 5, 6, 8, 12
NOISES = 6

# front left, front right, rear left, rear right: place from the centre of mass, and load of each
_FRONT, _LEFT = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, 1.0, -1.0])
_X = 0.5 * jackal.WHEELBASE * _FRONT - jackal.COM[0]
_Y = 0.5 * jackal.TRACK * _LEFT - jackal.COM[1]
_LOAD = (
    0.25
    * jackal.MASS
    * jackal.GRAVITY
    * (1.0 + 2.0 * jackal.COM[0] / jackal.WHEELBASE * _FRONT)
    * (1.0 + 2.0 * jackal.COM[1] / jackal.TRACK * _LEFT)
)
_V_STEP, _W_STEP = 0.125, 0.25  # of rim_table
_KEEP_WHEEL, _KEEP_GRIP = exp(-STEP / jackal.WHEEL_TIME), exp(-STEP / jackal.GRIP_TIME)
_KEEP_PULL = exp(-STEP / 0.02)


@kernel
def turn_wheels(drive, v, w, table, noise, slip):
    """One step of the velocity controller towards (v, w) [m/s, rad/s], within its acceleration limits.

    Sets the rim speeds drive[LEFT], drive[RIGHT] [m/s]. table: rim_table(); noise (6,) standard normal; `slip` scales
    all unevenness.
    """
    rate = jackal.MAX_ACCELERATION * STEP
    drive[RAMP_V] = min(max(v, drive[RAMP_V] - rate), drive[RAMP_V] + rate)
    rate = jackal.MAX_YAW_ACCELERATION * STEP
    drive[RAMP_W] = min(max(w, drive[RAMP_W] - rate), drive[RAMP_W] + rate)
    shake = sqrt(1.0 - _KEEP_WHEEL * _KEEP_WHEEL) * slip
    for i in range(2):
        drive[WHEEL_NOISE + i] = _KEEP_WHEEL * drive[WHEEL_NOISE + i] + shake * noise[i]
    shake = sqrt(1.0 - _KEEP_GRIP * _KEEP_GRIP) * jackal.GRIP_NOISE * slip
    for i in range(4):
        drive[GRIP_NOISE + i] = _KEEP_GRIP * drive[GRIP_NOISE + i] + shake * noise[2 + i]
    ahead, side = _rims(drive[RAMP_V], drive[RAMP_W], table)
    moving = jackal.WHEEL_SHAKE if drive[RAMP_V] != 0.0 or drive[RAMP_W] != 0.0 else 0.0
    drive[LEFT] = ahead - side + (moving + jackal.WHEEL_NOISE * abs(ahead - side)) * drive[WHEEL_NOISE]
    drive[RIGHT] = ahead + side + (moving + jackal.WHEEL_NOISE * abs(ahead + side)) * drive[WHEEL_NOISE + 1]


@kernel
def _rims(v, w, table):
    """Mean and half difference of the rim speeds for (v, w), bilinear in the table."""
    sign = 1.0 if v > 0.0 else -1.0
    a, b = min(abs(v) / _V_STEP, table.shape[0] - 1.001), min(abs(w) / _W_STEP, table.shape[1] - 1.001)
    i, j = int(a), int(b)
    a, b = a - i, b - j
    p, q, r, t = (1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b
    more = p * table[i, j, 0] + q * table[i, j + 1, 0] + r * table[i + 1, j, 0] + t * table[i + 1, j + 1, 0]
    spread = p * table[i, j, 1] + q * table[i, j + 1, 1] + r * table[i + 1, j, 1] + t * table[i + 1, j + 1, 1]
    return v + sign * more, 0.5 * jackal.TRACK * w * spread


@kernel
def tyres(drive, u, s, w, friction, lift):
    """Change (du, ds, dw) of the body's velocity by its tyres in one step.

    The centre of mass moves at (u, s) ahead and to the left [m/s], the body turns at w [rad/s]. `friction` of the
    wheels on the ground; lift (4,): share of its load that each wheel carries.

    Coulomb's friction, smooth below TYRE_CREEP, solved for the velocity at the step's end (two passes), so that it is
    stable and holds a standing robot still. The load shifts between the wheels with the acceleration.
    """
    mass, inertia = jackal.MASS, jackal.YAW_INERTIA
    tip_x = drive[PULL_X] * mass * jackal.COM_HEIGHT / (2.0 * jackal.WHEELBASE)
    tip_y = drive[PULL_Y] * mass * jackal.COM_HEIGHT / (2.0 * jackal.TRACK)
    du, ds, dw = 0.0, 0.0, 0.0
    for _ in range(2):
        # (M + sum k J'J) d = -sum k J' slip, for d = (du, ds, dw), with k = step * force / slip of each wheel
        a00, a11, a22, a02, a12 = mass, mass, inertia, 0.0, 0.0
        b0, b1, b2 = 0.0, 0.0, 0.0
        for i in range(4):
            rim = drive[LEFT] if i % 2 == 0 else drive[RIGHT]
            x, y = _X[i], _Y[i]
            slip_x, slip_y = u - w * y - rim, s + w * x
            end_x, end_y = slip_x + du - dw * y, slip_y + ds + dw * x
            load = _LOAD[i] + (-tip_x if i < 2 else tip_x) + (-tip_y if i % 2 == 0 else tip_y)
            grip = friction * max(0.0, 1.0 + drive[GRIP_NOISE + i]) * max(load, 0.0) * lift[i]
            k = STEP * grip / sqrt(end_x * end_x + end_y * end_y + jackal.TYRE_CREEP * jackal.TYRE_CREEP)
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


@lru_cache(maxsize=None)
def rim_table() -> np.ndarray:
    """Rim speeds that make the robot drive what was commanded on nominal, even ground: (17, 17, 2).

    Entry (i, j) belongs to speed i * .125 m/s and yaw rate j * .25 rad/s: what to add to the speed, and the multiplier
    of the track. Curves beyond the tyres' grip (v w above GRIP_LIMIT) take the multiplier of the tightest curve at that
    speed that they can hold. Found by driving; takes some 50 ms.
    """
    rows, columns = round(jackal.MAX_SPEED / _V_STEP) + 1, round(jackal.MAX_YAW_RATE / _W_STEP) + 1
    return _rim_table(rows, columns)


@kernel
def _rim_table(n_v, n_w):
    table = np.zeros((n_v, n_w, 2))
    for i in range(n_v):
        for j in range(n_w):
            v, w = i * _V_STEP, max(j, 1e-3) * _W_STEP
            if v * w > jackal.GRIP_LIMIT:
                table[i, j] = table[i, j - 1]
            else:
                table[i, j, 0], table[i, j, 1] = _settle(v, w)
    return table


@kernel
def _settle(v, w):
    """Drive at (v, w) and correct the rims until body and command agree: (to add to v, multiplier)."""
    drive, lift = np.zeros(SIZE), np.ones(4)
    half = 0.5 * jackal.TRACK
    ahead, side = v, 1.3 * half * w
    u, s, turn = v + w * jackal.COM[1], w * jackal.COM[0], w
    for _ in range(1200):
        drive[LEFT], drive[RIGHT] = ahead - side, ahead + side
        du, ds, dw = tyres(drive, u, s, turn, jackal.WHEEL_FRICTION, lift)
        u, s, turn = u + du, s + ds, turn + dw
        c, sn = cos(turn * STEP), sin(turn * STEP)
        u, s = c * u + sn * s, c * s - sn * u
        ahead += 0.02 * (v - u - turn * jackal.COM[1])
        side += 0.02 * half * (w - turn)
    return (ahead - v if v > 0.0 else 0.0), side / (half * w)
