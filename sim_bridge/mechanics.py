"""Mechanics of a robot for both simulators: masses, supports on the ground, limits.

`mechanics(robot)` returns the records that the kernels of wheels.py and kinematic_simulator.py
take. Lengths are in m, masses in kg. Positions are relative to the centre of mass of the robot
unless a comment names another origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import exp, hypot, sqrt
from typing import List, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.robots import Robot, geometry

from .records import Records, record

GRAVITY = geometry.GRAVITY
STEP = 1.0 / 240.0  # physics step of both simulators [s]
TABLE_INTERVALS = 16  # number of intervals of the table of rim speeds along each axis
LEFT_SIDE, RIGHT_SIDE, CASTER = 0.0, 1.0, 2.0  # values of Support.side


@dataclass(frozen=True)
class Constants:
    """Numbers of one robot for the kernels."""

    # Inertia
    mass: float  # [kg]
    yaw_inertia: float  # about the vertical axis through the centre of mass [kg m^2]
    com_x: float  # centre of mass in the base frame [m]
    com_y: float
    com_height: float  # height of the centre of mass above the ground [m]
    body_x: float  # centre of mass of the body without wheels in the base frame [m]
    body_y: float
    axle_z: float  # height of the axles relative to the centre of mass of the body [m]
    # Geometry
    track: float  # distance between left and right wheels [m]
    wheel_radius: float  # [m]
    wheel_width: float  # [m]
    reach: float  # radius of a circle around all parts [m]
    lever_x: float  # levers of the load transfer by acceleration, see Support.shift_x [m or m^2]
    lever_y: float
    # Velocity controller
    max_speed: float  # [m/s]
    acceleration: float  # largest acceleration of a ramp [m/s^2]
    yaw_acceleration: float  # largest yaw acceleration of a ramp [rad/s^2]
    intervals_per_speed: float  # intervals of the table of rim speeds per speed [s/m]
    intervals_per_turn: float  # intervals of the table of rim speeds per yaw rate [s/rad]
    track_multiplier: float  # multiplier of the track in the controller on Gazebo's ground
    # Random errors: a value of noise decays by the factor keep_* in each step, and draw_* times a
    # normal number is added.
    keep_wheel: float
    draw_wheel: float
    keep_grip: float
    draw_grip: float
    wheel_noise: float  # relative standard deviation of each side's speed
    wheel_shake: float  # standard deviation of each side's speed while the robot moves [m/s]
    # Contact of tyres and outline
    tyre_creep: float  # slip speed at which a tyre has .7 of its full friction [m/s]
    # Share of a wheel's load that moves to the outer edge per lateral acceleration [s^2/m]
    edge_shift: float
    full_lift: float  # height above the ground at which a wheel has no more friction [m]
    wheel_rub: float  # friction coefficient of a wheel along an obstacle
    body_rub: float  # friction coefficient of the body along an obstacle
    undo: float  # share of an overlap with an obstacle that is resolved in one step


@dataclass
class Support:
    """Driven wheel or caster."""

    x: float = 0.0  # position [m]
    y: float = 0.0
    load: float = 0.0  # load at rest [N]
    side: float = CASTER  # LEFT_SIDE or RIGHT_SIDE of a driven wheel, or CASTER
    friction_share: float = 1.0  # friction coefficient relative to that of a driven wheel
    # Load transfer: change of the load per moment of the acceleration about lever_x, lever_y
    shift_x: float = 0.0
    shift_y: float = 0.0
    body_x: float = 0.0  # position relative to the centre of mass of the body [m]
    body_y: float = 0.0
    # State, which the simulators change in a copy
    lift: float = 1.0  # share of the load that is carried: 1 with full contact, 0 off the ground
    grip_noise: float = 0.0  # relative noise of the friction


@dataclass(frozen=True, eq=False)
class Mechanics:
    """Numbers and arrays that the simulators derive from the description of a robot.

    Attributes:
        mass: Total mass [kg].
        com: Centre of mass of the robot in the base frame [m].
        body_com: Centre of mass of the body without wheels in the base frame [m].
        body_inertia: Moments of inertia of the body about x, y, z [kg m^2].
        wheel_inertia: Moments of inertia of a wheel about x, y, z [kg m^2].
        base_height: Height of the base frame above the ground [m].
        constants: Numbers for the kernels.
        supports: Records (n,) of Support: driven wheels in the order of geometry.wheel_places, then
            casters.
        parts: Rectangles (k, 4) of the outline: x, y, half length, half width [m]; the body, then
            the wheels.
    """

    mass: float
    com: Tuple[float, float]
    body_com: Tuple[float, float, float]
    body_inertia: Tuple[float, float, float]
    wheel_inertia: Tuple[float, float, float]
    base_height: float
    constants: Constants
    supports: Records
    parts: Array


@lru_cache(maxsize=64)
def mechanics(robot: Robot) -> Mechanics:
    """Return the mechanics of a robot, whose centre of mass must lie within the supports.

    robots/check.py reports a robot that would tip over.
    """
    base = robot.base
    body = robot.body
    simulation = robot.simulation
    wheels = base.wheels
    mass, com, loads = geometry.balance(robot)
    body_com = body.centre_of_mass

    # Body and wheels without given inertia are a solid box and solid cylinders about the y axis.
    length2, width2, height2 = (size * size for size in body.size)
    twelfth = body.mass / 12
    solid_box = (
        twelfth * (width2 + height2),
        twelfth * (length2 + height2),
        twelfth * (length2 + width2),
    )
    body_inertia = body.inertia or solid_box
    radius = base.wheel_radius
    about_axle = base.wheel_mass / 2 * radius * radius
    across = base.wheel_mass / 12 * (3 * radius * radius + base.wheel_width * base.wheel_width)
    wheel_inertia = base.wheel_inertia or (across, about_axle, across)

    # Parallel axes: the inertia of the parts about the base frame, less that of the whole mass at
    # its centre.
    yaw_inertia = (
        body_inertia[2]
        + wheels * wheel_inertia[2]
        + wheels * base.wheel_mass * (base.track**2 + base.wheelbase**2) / 4
        + body.mass * (body_com[0] ** 2 + body_com[1] ** 2)
        - mass * (com[0] ** 2 + com[1] ** 2)
    )
    base_height = base.wheel_radius - base.axle_height
    moment_of_heights = body.mass * body_com[2] + wheels * base.wheel_mass * base.axle_height
    supports, levers = _supports(robot, com, loads)
    # The parts move relative to the centre of mass, and keep their sizes.
    com_x, com_y = com
    parts = np.array(geometry.parts(robot)) - np.array([com_x, com_y, 0.0, 0.0])
    keep_wheel = exp(-STEP / simulation.wheel_time)
    keep_grip = exp(-STEP / simulation.grip_time)
    constants = Constants(
        mass=mass,
        yaw_inertia=yaw_inertia,
        com_x=com[0],
        com_y=com[1],
        com_height=base_height + moment_of_heights / mass,
        body_x=body_com[0],
        body_y=body_com[1],
        axle_z=base.axle_height - body_com[2],
        track=base.track,
        wheel_radius=base.wheel_radius,
        wheel_width=base.wheel_width,
        reach=geometry.radius(robot) + hypot(*com),
        lever_x=levers[0],
        lever_y=levers[1],
        max_speed=base.max_speed,
        acceleration=base.max_acceleration,
        yaw_acceleration=base.max_yaw_acceleration,
        intervals_per_speed=TABLE_INTERVALS / base.max_speed,
        intervals_per_turn=TABLE_INTERVALS / base.max_yaw_rate,
        track_multiplier=simulation.track_multiplier or 1.0,
        keep_wheel=keep_wheel,
        # With this factor, the variance of the noise stays that of a new draw.
        draw_wheel=sqrt(1.0 - keep_wheel * keep_wheel),
        keep_grip=keep_grip,
        draw_grip=sqrt(1.0 - keep_grip * keep_grip) * simulation.grip_noise,
        wheel_noise=simulation.wheel_noise,
        wheel_shake=simulation.wheel_shake,
        tyre_creep=simulation.tyre_creep,
        edge_shift=simulation.edge_shift,
        full_lift=simulation.full_lift,
        wheel_rub=simulation.wheel_rub,
        body_rub=simulation.body_rub,
        undo=simulation.undo,
    )
    for array in (supports, parts):
        array.setflags(write=False)
    return Mechanics(
        mass, com, body_com, body_inertia, wheel_inertia, base_height, constants, supports, parts
    )


def _supports(robot: Robot, com: Tuple[float, float], loads: Array) -> Tuple[Records, List[float]]:
    """Return the records of the supports, and the levers of the load transfer along x and y.

    Args:
        robot: Description of the robot.
        com: Centre of mass in the base frame [m].
        loads: Loads (n,) of the supports at rest [N].
    """
    base = robot.base
    contact_points = geometry.supports(base)
    is_driven = np.arange(len(contact_points)) < base.wheels
    sides = np.where(contact_points[:, 1] > 0.0, LEFT_SIDE, RIGHT_SIDE)
    if base.wheels == 4:
        # Wheels in a rectangle share the load transfer equally.
        shifts = -np.sign(contact_points)
        levers = [2.0 * base.wheelbase, 2.0 * base.track]
    else:
        # These are the smallest load changes that balance a moment.
        centred_points = contact_points - contact_points.mean(axis=0)
        shifts = -centred_points
        levers = [float(lever) or 1.0 for lever in (centred_points**2).sum(axis=0)]

    body_com = robot.body.centre_of_mass
    supports = np.repeat(record(Support()), len(contact_points))
    supports["x"] = contact_points[:, 0] - com[0]
    supports["y"] = contact_points[:, 1] - com[1]
    supports["load"] = loads
    supports["side"] = np.where(is_driven, sides, CASTER)
    caster_share = base.caster_friction / base.wheel_friction
    supports["friction_share"] = np.where(is_driven, 1.0, caster_share)
    supports["shift_x"] = shifts[:, 0]
    supports["shift_y"] = shifts[:, 1]
    supports["body_x"] = contact_points[:, 0] - body_com[0]
    supports["body_y"] = contact_points[:, 1] - body_com[1]
    return supports, levers
