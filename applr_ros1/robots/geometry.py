"""Geometry of a robot: rectangles of its body and wheels, its mass, and the loads of its supports.

Both simulators, the monitor's settings, the model for RViz and the check of robot.yaml use this module.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import List, Tuple

import numpy as np

from applr_ros1.robots.robot import Base, Robot

GRAVITY = 9.8  # gravitational acceleration [m/s^2]
Rectangle = Tuple[float, float, float, float]  # x, y of the centre, half length, half width [m]


def wheel_places(base: Base) -> List[Tuple[float, float]]:
    """Return the positions (x, y) [m] of the driven wheels, front before rear and left before right."""
    axles = (base.wheelbase / 2, -base.wheelbase / 2) if base.wheels == 4 else (0.0,)
    return [(x, y) for x in axles for y in (base.track / 2, -base.track / 2)]


def parts(robot: Robot) -> List[Rectangle]:
    """Return the rectangles that can touch an obstacle: the body, then the wheels."""
    base, body = robot.base, robot.body
    wheels = [(x, y, base.wheel_radius, base.wheel_width / 2) for x, y in wheel_places(base)]
    # The corners of four rectangles form a 16-sided polygon around an ellipse.
    turns = pi / 16 * np.arange(1, 8, 2) if body.round else ()
    shares = [(cos(turn) / cos(pi / 16), sin(turn) / cos(pi / 16)) for turn in turns] or [(1.0, 1.0)]
    return [(*body.centre, a * body.size[0] / 2, b * body.size[1] / 2) for a, b in shares] + wheels


def corners(robot: Robot) -> np.ndarray:
    """Return the corners (n, 2) [m] of all parts of a round body, or of the bounding box of any other robot."""
    if robot.body.round:
        return np.array([(x + i * a, y + j * b) for x, y, a, b in parts(robot) for i in (1, -1) for j in (1, -1)])
    back, front, right, left = bounding_box(robot)
    return np.array([(front, left), (front, right), (back, right), (back, left)])


def bounding_box(robot: Robot) -> Tuple[float, float, float, float]:
    """Return smallest x, largest x, smallest y and largest y of all parts [m]."""
    rectangles = parts(robot)
    return (
        min(x - a for x, _, a, _ in rectangles),
        max(x + a for x, _, a, _ in rectangles),
        min(y - b for _, y, _, b in rectangles),
        max(y + b for _, y, _, b in rectangles),
    )


def radius(robot: Robot) -> float:
    """Return the radius of the circle around the base frame that contains all parts [m]."""
    return float(np.hypot(*corners(robot).T).max())


def supports(base: Base) -> np.ndarray:
    """Return the contact points (n, 2) [m] with the ground: the driven wheels, then the casters."""
    return np.array(wheel_places(base) + [tuple(place) for place in base.casters])


def balance(robot: Robot) -> Tuple[float, Tuple[float, float], np.ndarray]:
    """Return mass [kg], centre of mass (x, y) [m] and support loads (n,) [N]; the robot tips if a load is negative."""
    base, body = robot.base, robot.body
    mass = body.mass + base.wheels * base.wheel_mass
    com = (body.mass / mass * body.centre_of_mass[0], body.mass / mass * body.centre_of_mass[1])
    places = supports(base)
    if base.wheels == 4:  # The wheels form a rectangle.
        front, left = np.sign(places[:, 0]), np.sign(places[:, 1])
        along = 1.0 + 2.0 * com[0] / base.wheelbase * front
        return mass, com, 0.25 * mass * GRAVITY * along * (1.0 + 2.0 * com[1] / base.track * left)
    upright = np.array([np.ones(len(places)), places[:, 0], places[:, 1]])  # equilibrium of forces and moments
    return mass, com, np.linalg.pinv(upright) @ (mass * GRAVITY * np.array([1.0, *com]))
