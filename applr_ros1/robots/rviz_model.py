"""Model of a simulated robot for RViz, made from its description: box, wheels, casters and laser.

`rosrun applr_ros1 robot_model.py` prints the model for the parameter robot_description. All shapes
belong to one link, so that no joint states are needed. A real robot already has a
robot_description.
"""

from __future__ import annotations

import sys
from typing import List, Tuple
from xml.sax.saxutils import quoteattr

from applr_ros1.common.arguments import without_remappings
from applr_ros1.robots import geometry, load
from applr_ros1.robots.robot import Robot

_COLOURS = (("body", "0.92 0.72 0.05 1"), ("black", "0.12 0.12 0.12 1"))


def urdf(robot: Robot) -> str:
    """Return the URDF text of a robot."""
    base = robot.base
    body = robot.body
    laser = robot.laser
    length, width, height = body.size
    ground = base.axle_height - base.wheel_radius

    # URDF has no elliptic cylinder: an oval body is drawn with its mean radius.
    shape = f'<box size="{length:g} {width:g} {height:g}"/>'
    if body.round:
        shape = _cylinder((length + width) / 4, height)
    shapes = [_visual((*body.centre, body.bottom + height / 2), shape, "body")]
    wheel = _cylinder(base.wheel_radius, base.wheel_width)
    for x, y in geometry.wheel_places(base):
        shapes.append(_visual((x, y, base.axle_height), wheel, "black", "1.5708 0 0"))
    # Casters fill the space between ground and body.
    radius = max((body.bottom - ground) / 2, 0.1 * base.wheel_radius)
    for x, y in base.casters:
        shapes.append(_visual((x, y, ground + radius), f'<sphere radius="{radius:g}"/>', "black"))
    # The description has no size of the laser.
    laser_size = 0.2 * min(length, width)
    laser_shape = _visual((0.0, 0.0, 0.0), _cylinder(laser_size / 2, laser_size), "black")

    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(robot.name)}>"]
    for name, rgba in _COLOURS:
        lines.append(f'  <material name="{name}"><color rgba="{rgba}"/></material>')
    lines += _link(robot.frames.base, shapes)
    lines += _link(laser.frame, [laser_shape])
    x, y, yaw = laser.pose
    lines += [
        '  <joint name="laser_mount" type="fixed">',
        f"    <parent link={quoteattr(robot.frames.base)}/>",
        f"    <child link={quoteattr(laser.frame)}/>",
        f'    <origin xyz="{x:g} {y:g} {laser.height:g}" rpy="0 0 {yaw:g}"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _link(name: str, visuals: List[str]) -> List[str]:
    """Return the lines of a link that shows some shapes."""
    return [f"  <link name={quoteattr(name)}>", *visuals, "  </link>"]


def _visual(place: Tuple[float, float, float], shape: str, colour: str, turn: str = "0 0 0") -> str:
    """Return the line of a shape at a place (x, y, z) [m]; `turn` is roll, pitch, yaw [rad]."""
    x, y, z = place
    origin = f'<origin xyz="{x:g} {y:g} {z:g}" rpy="{turn}"/>'
    return f'    <visual>{origin}<geometry>{shape}</geometry><material name="{colour}"/></visual>'


def _cylinder(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:g}" length="{length:g}"/>'


def main() -> None:
    """Print the model of the robot named by the first argument, by default the Jackal."""
    name, *_ = [*without_remappings(), "jackal"]
    sys.stdout.write(urdf(load(name)))
