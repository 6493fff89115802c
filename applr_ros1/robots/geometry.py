"""Geometry of a robot: rectangles of its body and wheels, its mass, and the loads of its supports.

Both simulators, the monitor's settings, the model for RViz and the check of robot.yaml use this
module.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import List, NamedTuple, Tuple

import numpy as np
import scipy

from applr_ros1.common.arrays import Array
from applr_ros1.robots.robot import Base, Robot

GRAVITY = 9.8  # gravitational acceleration [m/s^2]
# Squared distance, in half axes, up to which a point counts as within an oval: 1 with rounding
SQUARED_OVAL = 1.02


def _round_shares() -> List[Tuple[float, float]]:
    """Return the shares of a round body's size in four rectangles.

    Their corners form a 16-sided polygon around the ellipse, whose sides touch it.
    """
    half_side = pi / 16  # angle that half a side covers [rad]
    apothem = cos(half_side)  # distance of a side's middle from the centre; that of a corner is 1
    shares = []
    for corner in (1, 3, 5, 7):
        angle = half_side * corner
        shares.append((cos(angle) / apothem, sin(angle) / apothem))
    return shares


ROUND_SHARES = _round_shares()


class Rectangle(NamedTuple):
    """Part of a robot along the axes of its base frame: centre, half length, half width [m]."""

    x: float
    y: float
    half_length: float
    half_width: float


class Box(NamedTuple):
    """Bounding box of all parts: smallest and largest x, smallest and largest y [m]."""

    back: float
    front: float
    right: float
    left: float


class Balance(NamedTuple):
    """Weight of a robot.

    Attributes:
        mass: Mass of body and wheels [kg].
        com: Centre of mass (x, y) in the base frame [m].
        loads: (n,) loads of the supports [N]. The robot tips if a load is negative.
    """

    mass: float
    com: Tuple[float, float]
    loads: Array


def wheel_places(base: Base) -> List[Tuple[float, float]]:
    """Return the places (x, y) [m] of the driven wheels, front before rear, left before right."""
    axles: Tuple[float, ...] = (0.0,)
    if base.wheels == 4:
        axles = (base.wheelbase / 2, -base.wheelbase / 2)
    wheel_centres = []
    for x in axles:
        wheel_centres += [(x, base.track / 2), (x, -base.track / 2)]
    return wheel_centres


def parts(robot: Robot) -> List[Rectangle]:
    """Return the rectangles that can touch an obstacle: the body, then the wheels."""
    base = robot.base
    body = robot.body
    length, width, _ = body.size
    shares = [(1.0, 1.0)]
    if body.round:
        shares = ROUND_SHARES
    rectangles = []
    for length_share, width_share in shares:
        half_length = length_share * length / 2
        half_width = width_share * width / 2
        rectangles.append(Rectangle(*body.centre, half_length, half_width))
    for x, y in wheel_places(base):
        rectangles.append(Rectangle(x, y, base.wheel_radius, base.wheel_width / 2))
    return rectangles


def corners(robot: Robot) -> Array:
    """Return the corners (n, 2) [m] of a robot's outline.

    They are those of all parts of a round body, or of the bounding box of any other robot.
    """
    # The monitor takes the outline as convex: the gaps between wheels and body count as robot.
    if not robot.body.round:
        return _box_corners(robot)
    vertices = []
    for x, y, half_length, half_width in parts(robot):
        for corner_x in (x + half_length, x - half_length):
            vertices += [(corner_x, y + half_width), (corner_x, y - half_width)]
    return np.array(vertices)


def _box_corners(robot: Robot) -> Array:
    """Return the corners (4, 2) [m] of the bounding box, clockwise from the front left one."""
    box = bounding_box(robot)
    return np.array(
        [
            (box.front, box.left),
            (box.front, box.right),
            (box.back, box.right),
            (box.back, box.left),
        ]
    )


def outline(robot: Robot) -> Array:
    """Return the corners (n, 2) [m] of the convex outline of a robot, in order around it."""
    points = corners(robot)
    hull_points: Array = points[scipy.spatial.ConvexHull(points).vertices]
    return hull_points


def is_oval(points: Array) -> bool:
    """Return whether points (n, 2) lie within the oval that fills their bounds."""
    lowest = points.min(axis=0)
    highest = points.max(axis=0)
    # Positions with the half axes as units: a box has corners at a squared distance of 2.
    scaled = (points - (lowest + highest) / 2) / ((highest - lowest) / 2)
    return bool(np.square(scaled).sum(axis=1).max() < SQUARED_OVAL)


def bounding_box(robot: Robot) -> Box:
    """Return the box around all parts."""
    x, y, half_length, half_width = np.array(parts(robot)).T
    return Box(
        back=float(np.min(x - half_length)),
        front=float(np.max(x + half_length)),
        right=float(np.min(y - half_width)),
        left=float(np.max(y + half_width)),
    )


def radius(robot: Robot) -> float:
    """Return the radius of the circle around the base frame that contains all parts [m]."""
    x, y = corners(robot).T
    return float(np.hypot(x, y).max())


def supports(base: Base) -> Array:
    """Return the contact points (n, 2) [m] with the ground: the driven wheels, then the casters."""
    return np.array([*wheel_places(base), *base.casters])


def caster_radius(robot: Robot) -> float:
    """Return the radius of a caster [m], a ball that fills the gap between ground and body.

    It is small under a low body.
    """
    base = robot.base
    clearance = base.wheel_radius - base.axle_height + robot.body.bottom
    return max(clearance / 2, 0.1 * base.wheel_radius)


def balance(robot: Robot) -> Balance:
    """Return mass, centre of mass and support loads of a robot.

    Equilibrium of forces and moments determines three loads, and most robots have more supports.
    Makers load the driven wheels, whose grip moves the robot, and spring the casters, or let them
    clear the ground: casters carry only what the wheels cannot. Two wheels on one axle carry every
    sideways moment, but not the moment of a centre of mass ahead of the axle or behind it. The
    robot leans on the casters of that side, in proportion to their distance from the axle, and
    those of the other side carry nothing.
    """
    base = robot.base
    body = robot.body
    mass = body.mass + base.wheels * base.wheel_mass
    body_share = body.mass / mass  # The wheels' centre of mass is at the origin.
    x = body_share * body.centre_of_mass[0]
    y = body_share * body.centre_of_mass[1]
    weight = mass * GRAVITY
    if base.wheels == 4:
        # Of the solutions of equilibrium, the bilinear one never gives a wheel of the rectangle a
        # negative load if the centre of mass is between the wheels. The smallest loads may do so.
        contact_x, contact_y = supports(base).T
        along_factor = 1.0 + 2.0 * x / base.wheelbase * np.sign(contact_x)
        across_factor = 1.0 + 2.0 * y / base.track * np.sign(contact_y)
        return Balance(mass, (x, y), 0.25 * weight * along_factor * across_factor)

    # Casters, by their distance from the axle on the side to which the robot leans. If this side
    # has none, the others would have to pull.
    caster_x, caster_y = np.array(base.casters).T
    distances = np.copysign(1.0, x) * caster_x
    if distances.max() > 0.0:
        distances = np.maximum(distances, 0.0)
    caster_loads = weight * abs(x) * distances / (distances @ distances)

    # Wheels, left before right
    half_load = (weight - caster_loads.sum()) / 2
    sideways_moment = weight * y - caster_loads @ caster_y
    shift = sideways_moment / base.track
    return Balance(mass, (x, y), np.array([half_load + shift, half_load - shift, *caster_loads]))


def box_outline(robot: Robot) -> List[List[float]]:
    """Return the corners [x, y] of the box around body and wheels, three digits each [m]."""
    outline = []
    for x, y in np.roll(_box_corners(robot), 2, axis=0).tolist():
        outline.append([float(f"{x:.3g}"), float(f"{y:.3g}")])
    return outline
