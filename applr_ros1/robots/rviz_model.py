"""Model of a simulated robot for RViz, made from its description: box, wheels, casters and laser.

`rosrun applr_ros1 robot_model.py` prints the model for the parameter robot_description. All shapes belong to one link,
so that no joint states are needed. A real robot already has a robot_description.
"""

from __future__ import annotations

import sys
from typing import List, Sequence, Tuple
from xml.sax.saxutils import quoteattr

from applr_ros1.common.arguments import without_remappings
from applr_ros1.robots import geometry, load
from applr_ros1.robots.robot import Robot

_COLOURS = (("body", "0.92 0.72 0.05 1"), ("black", "0.12 0.12 0.12 1"))


def urdf(robot: Robot) -> str:
    """Return the URDF text of a robot."""
    base, body, laser = robot.base, robot.body, robot.laser
    length, width, height = body.size
    shape = _cylinder((length + width) / 4, height) if body.round else _box(body.size)
    shapes = [_visual((*body.centre, body.bottom + height / 2), shape, "body")]
    for x, y in geometry.wheel_places(base):
        wheel = _cylinder(base.wheel_radius, base.wheel_width)
        shapes.append(_visual((x, y, base.axle_height), wheel, "black", "1.5708 0 0"))
    radius = max((base.wheel_radius - base.axle_height + body.bottom) / 2, 0.1 * base.wheel_radius)
    for x, y in base.casters:
        sphere = f'<sphere radius="{radius:g}"/>'
        shapes.append(_visual((x, y, radius - base.wheel_radius + base.axle_height), sphere, "black"))
    size = 0.2 * min(body.size[0], body.size[1])
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(robot.name)}>"]
    lines += ['  <material name="%s"><color rgba="%s"/></material>' % colour for colour in _COLOURS]
    lines += _link(robot.frames.base, shapes)
    lines += _link(laser.frame, [_visual((0.0, 0.0, 0.0), _cylinder(size / 2, size), "black")])
    lines += [
        '  <joint name="laser_mount" type="fixed">',
        f"    <parent link={quoteattr(robot.frames.base)}/>",
        f"    <child link={quoteattr(laser.frame)}/>",
        f'    <origin xyz="{laser.pose[0]:g} {laser.pose[1]:g} {laser.height:g}" rpy="0 0 {laser.pose[2]:g}"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _link(name: str, visuals: List[str]) -> List[str]:
    return [f"  <link name={quoteattr(name)}>"] + visuals + ["  </link>"]


def _visual(place: Tuple[float, float, float], shape: str, colour: str, turn: str = "0 0 0") -> str:
    origin = '<origin xyz="%g %g %g" rpy="%s"/>' % (*place, turn)
    return f'    <visual>{origin}<geometry>{shape}</geometry><material name="{colour}"/></visual>'


def _box(size: Sequence[float]) -> str:
    return '<box size="%g %g %g"/>' % tuple(size)


def _cylinder(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:g}" length="{length:g}"/>'


def main() -> None:
    """Print the model of the robot named by the first argument, by default the Jackal."""
    names = without_remappings()
    sys.stdout.write(urdf(load(names[0] if names else "jackal")))
