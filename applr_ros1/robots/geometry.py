"""Where a robot reaches: the rectangle around its body and wheels, for contacts and for the collision monitor.

Both simulators, the monitor's settings and RViz's model use it.
"""

from __future__ import annotations

from typing import List, Tuple

from applr_ros1.robots.description import Base, Robot

Rectangle = Tuple[float, float, float, float]  # x, y of the middle, half length, half width


def wheel_places(base: Base) -> List[Tuple[float, float]]:
    """(x, y) of the driven wheels [m], front before rear, left before right."""
    axles = (base.wheelbase / 2, -base.wheelbase / 2) if base.wheels == 4 else (0.0,)
    return [(x, y) for x in axles for y in (base.track / 2, -base.track / 2)]


def parts(robot: Robot) -> List[Rectangle]:
    """The rectangles that can touch an obstacle: the body, then the wheels."""
    base, body = robot.base, robot.body
    wheels = [(x, y, base.wheel_radius, base.wheel_width / 2) for x, y in wheel_places(base)]
    return [(*body.centre, body.size[0] / 2, body.size[1] / 2)] + wheels


def bounding_box(robot: Robot) -> Tuple[float, float, float, float]:
    """Smallest x, largest x, smallest y, largest y of all parts [m]."""
    found = parts(robot)
    return (
        min(x - a for x, _, a, _ in found),
        max(x + a for x, _, a, _ in found),
        min(y - b for _, y, _, b in found),
        max(y + b for _, y, _, b in found),
    )
