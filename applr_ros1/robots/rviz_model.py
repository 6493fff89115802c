"""Model of a simulated robot for RViz, made from its description: box, wheels, casters and laser.

`rosrun applr_ros1 robot_model.py` prints the model for the parameter robot_description. All shapes
belong to one link, so that no joint states are needed. A real robot already has a
robot_description.
"""

from __future__ import annotations

import sys
from typing import Iterator, List, Tuple
from xml.sax.saxutils import quoteattr

from applr_ros1.common.arguments import without_remappings
from applr_ros1.robots import geometry, load
from applr_ros1.robots.robot import Base, Body, Robot

_COLOURS = (("body", "0.92 0.72 0.05 1"), ("black", "0.12 0.12 0.12 1"))


def urdf(robot: Robot) -> str:
    """Return the URDF text of a robot."""
    laser = robot.laser
    # The description has no size of the laser.
    laser_size = 0.2 * min(robot.body.size[:2])
    laser_cylinder = _cylinder(laser_size / 2, laser_size)

    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(robot.name)}>"]
    for colour_name, colour_value in _COLOURS:
        lines.append(f'  <material name="{colour_name}"><color rgba="{colour_value}"/></material>')
    visuals = [_body(robot.body), *_wheels(robot.base), *_casters(robot)]
    lines += _link(robot.frames.base, visuals)
    lines += _link(laser.frame, [_visual((0.0, 0.0, 0.0), laser_cylinder, "black")])

    # The joint places the laser's link on the base, at the height of the scans.
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


def _body(body: Body) -> str:
    """Return the line of the body, a box or a cylinder."""
    length, width, height = body.size
    shape_tag = f'<box size="{length:g} {width:g} {height:g}"/>'
    if body.round:
        # URDF has no elliptic cylinder: an oval body is drawn with its mean radius.
        shape_tag = _cylinder((length + width) / 4, height)
    x, y = body.centre
    return _visual((x, y, body.bottom + height / 2), shape_tag, "body")


def _wheels(base: Base) -> Iterator[str]:
    """Yield the line of each driven wheel."""
    wheel_tag = _cylinder(base.wheel_radius, base.wheel_width)
    for x, y in geometry.wheel_places(base):
        # A cylinder stands upright unless it is turned by 90 degrees.
        yield _visual((x, y, base.axle_height), wheel_tag, "black", turn="1.5708 0 0")


def _casters(robot: Robot) -> Iterator[str]:
    """Yield the line of each caster, a ball that fills the space between ground and body."""
    base = robot.base
    ground_height = base.axle_height - base.wheel_radius
    radius = geometry.caster_radius(robot)
    ball_tag = f'<sphere radius="{radius:g}"/>'
    for x, y in base.casters:
        yield _visual((x, y, ground_height + radius), ball_tag, "black")


def _link(name: str, visuals: List[str]) -> List[str]:
    """Return the lines of a link that shows some shapes."""
    return [f"  <link name={quoteattr(name)}>", *visuals, "  </link>"]


def _visual(
    position: Tuple[float, float, float], shape: str, colour: str, turn: str = "0 0 0"
) -> str:
    """Return the line of a shape at a position (x, y, z) [m]; `turn` is roll, pitch, yaw [rad]."""
    x, y, z = position
    origin_tag = f'<origin xyz="{x:g} {y:g} {z:g}" rpy="{turn}"/>'
    geometry_tag = f"<geometry>{shape}</geometry>"
    material_tag = f'<material name="{colour}"/>'
    return f"    <visual>{origin_tag}{geometry_tag}{material_tag}</visual>"


def _cylinder(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:g}" length="{length:g}"/>'


def main() -> None:
    """Print the model of the robot named by the first argument, by default the Jackal."""
    arguments = without_remappings()
    robot_name = "jackal"
    if arguments:
        robot_name = arguments[0]
    sys.stdout.write(urdf(load(robot_name)))
