"""Mechanics of a robot for both simulators: masses, supports on the ground, limits.

`mechanics(robot)` returns the arrays that the kernels of wheels.py and kinematic_simulator.py take. Lengths are in m,
masses in kg. Positions are relative to the centre of mass unless a name indicates another origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import exp, hypot, sqrt
from typing import List, Tuple

import numpy as np

from applr_ros1.robots import Robot, geometry

GRAVITY = geometry.GRAVITY
STEP = 1.0 / 240.0  # physics step of both simulators [s]

# Indices of the vector of scalars that the kernels take
MASS, YAW_INERTIA, COM_X, COM_Y, COM_HEIGHT, LEVER_X, LEVER_Y, TRACK, REACH = range(9)
MAX_SPEED, ACCELERATION, YAW_ACCELERATION, PER_V, PER_W = range(9, 14)
KEEP_WHEEL, KEEP_GRIP, DRAW_WHEEL, DRAW_GRIP, WHEEL_NOISE, WHEEL_SHAKE, TYRE_CREEP = range(14, 21)
AXLE_Z, WHEEL_RADIUS, FULL_LIFT, OFF_X, OFF_Y = range(21, 26)
WHEEL_RUB, BODY_RUB, UNDO, TRACK_MULTIPLIER, WHEEL_WIDTH, EDGE_SHIFT, SCALARS = range(26, 33)

# Columns of the supports
X, Y, LOAD, SIDE, SHARE, SHIFT_X, SHIFT_Y, BASE_X, BASE_Y, COLUMNS = range(10)
LEFT_SIDE, RIGHT_SIDE, CASTER = 0.0, 1.0, 2.0
TABLE = 16  # number of intervals of the table of rim speeds, up to the largest speed and yaw rate


@dataclass(frozen=True, eq=False)
class Mechanics:
    """Numbers and arrays that the simulators derive from the description of a robot.

    Attributes:
        mass, com, body_com: Total mass [kg]; centres of mass of robot and body in the base frame [m].
        body_inertia, wheel_inertia: Moments of inertia about x, y, z [kg m^2].
        base_height: Height of the base frame above the ground [m].
        scalars: Numbers (SCALARS,) for the kernels, in the order of the indices MASS to EDGE_SHIFT.
        supports: Driven wheels in the order of geometry.wheel_places, then casters, (n, COLUMNS): position X, Y, LOAD
            at rest [N], SIDE of the wheel or CASTER, SHARE of a wheel's friction, load transfer SHIFT_X, SHIFT_Y per
            acceleration (along LEVER_X, LEVER_Y), position BASE_X, BASE_Y relative to the body's centre of mass.
        parts: Rectangles (k, 4) of the outline: x, y, half length, half width [m]; the body, then the wheels.
    """

    mass: float
    com: Tuple[float, float]
    body_com: Tuple[float, float, float]
    body_inertia: Tuple[float, float, float]
    wheel_inertia: Tuple[float, float, float]
    base_height: float
    scalars: np.ndarray
    supports: np.ndarray
    parts: np.ndarray


@lru_cache(maxsize=64)
def mechanics(robot: Robot) -> Mechanics:
    """Return the mechanics of a robot. Its centre of mass must lie within the supports (see robots/check.py)."""
    base, body = robot.base, robot.body
    n = base.wheels
    mass, com, loads = geometry.balance(robot)
    body_com = body.centre_of_mass
    x2, y2, z2 = (value * value for value in body.size)
    part = body.mass / 12
    inertia = body.inertia or (part * (y2 + z2), part * (x2 + z2), part * (x2 + y2))
    across = base.wheel_mass / 12 * (3 * base.wheel_radius * base.wheel_radius + base.wheel_width * base.wheel_width)
    wheel = base.wheel_inertia or (across, base.wheel_mass / 2 * base.wheel_radius * base.wheel_radius, across)
    base_height = base.wheel_radius - base.axle_height
    com_height = base_height + (body.mass * body_com[2] + n * base.wheel_mass * base.axle_height) / mass
    yaw_inertia = (
        inertia[2]
        + n * wheel[2]
        + n * base.wheel_mass * (base.track**2 + base.wheelbase**2) / 4
        + body.mass * (body_com[0] ** 2 + body_com[1] ** 2)
        - mass * (com[0] ** 2 + com[1] ** 2)
    )
    supports, levers = _supports(robot, com, loads)
    supports[:, BASE_X] = supports[:, BASE_X] - body_com[0]
    supports[:, BASE_Y] = supports[:, BASE_Y] - body_com[1]
    parts = np.array(geometry.parts(robot)) - np.array([com[0], com[1], 0.0, 0.0])
    back, front, right, left = geometry.bounding_box(robot)
    reach = hypot(max(front, -back), max(left, -right)) + hypot(*com)
    simulation = robot.simulation
    scalars = np.zeros(SCALARS)
    scalars[[MASS, YAW_INERTIA, COM_X, COM_Y, COM_HEIGHT]] = mass, yaw_inertia, *com, com_height
    scalars[[LEVER_X, LEVER_Y, TRACK, REACH]] = *levers, base.track, reach
    limits = base.max_speed, base.max_acceleration, base.max_yaw_acceleration
    scalars[[MAX_SPEED, ACCELERATION, YAW_ACCELERATION]] = limits
    keep_wheel, keep_grip = exp(-STEP / simulation.wheel_time), exp(-STEP / simulation.grip_time)
    scalars[[KEEP_WHEEL, KEEP_GRIP]] = keep_wheel, keep_grip
    scalars[DRAW_WHEEL] = sqrt(1.0 - keep_wheel * keep_wheel)
    scalars[DRAW_GRIP] = sqrt(1.0 - keep_grip * keep_grip) * simulation.grip_noise
    noise = simulation.wheel_noise, simulation.wheel_shake, simulation.tyre_creep
    scalars[[WHEEL_NOISE, WHEEL_SHAKE, TYRE_CREEP]] = noise
    scalars[[PER_V, PER_W]] = TABLE / base.max_speed, TABLE / base.max_yaw_rate
    scalars[[AXLE_Z, WHEEL_RADIUS, FULL_LIFT]] = base.axle_height - body_com[2], base.wheel_radius, simulation.full_lift
    scalars[[OFF_X, OFF_Y]] = body_com[0], body_com[1]
    scalars[[WHEEL_RUB, BODY_RUB, UNDO]] = simulation.wheel_rub, simulation.body_rub, simulation.undo
    scalars[[TRACK_MULTIPLIER, WHEEL_WIDTH]] = simulation.track_multiplier or 1.0, base.wheel_width
    scalars[EDGE_SHIFT] = simulation.edge_shift
    for array in (scalars, supports, parts):
        array.setflags(write=False)
    return Mechanics(mass, com, body_com, inertia, wheel, base_height, scalars, supports, parts)


def _supports(robot: Robot, com: Tuple[float, float], loads: np.ndarray) -> Tuple[np.ndarray, List[float]]:
    """Return the array of supports, and the levers of the load transfer along x and y [m]."""
    base, places = robot.base, geometry.supports(robot.base)
    supports = np.zeros((len(places), COLUMNS))
    supports[:, X], supports[:, Y] = places[:, 0] - com[0], places[:, 1] - com[1]
    supports[:, BASE_X], supports[:, BASE_Y] = places.T
    wheels = np.arange(len(places)) < base.wheels
    supports[:, SIDE] = np.where(wheels, np.where(places[:, 1] > 0.0, LEFT_SIDE, RIGHT_SIDE), CASTER)
    supports[:, SHARE] = np.where(wheels, 1.0, base.caster_friction / base.wheel_friction)
    supports[:, LOAD] = loads
    if base.wheels == 4:  # Wheels in a rectangle share the load transfer equally.
        supports[:, [SHIFT_X, SHIFT_Y]] = -np.sign(places)
        return supports, [2.0 * base.wheelbase, 2.0 * base.track]
    centred = places - places.mean(axis=0)  # These are the smallest load changes that balance a moment.
    supports[:, [SHIFT_X, SHIFT_Y]] = -centred
    return supports, [float(value) or 1.0 for value in (centred**2).sum(axis=0)]
