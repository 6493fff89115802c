"""Model of a simulated robot for RViz, made from its description: box, wheels, casters and laser.

`rosrun applr_ros1 robot_model.py` prints the model for the parameter robot_description. All shapes
belong to one link, so that no joint states are needed. A real robot already has a
robot_description.
"""

from __future__ import annotations

import sys
from typing import Iterator, Tuple
from xml.etree.ElementTree import Element, tostring

from applr_ros1.common.arguments import without_remappings
from applr_ros1.robots import geometry, load
from applr_ros1.robots.robot import Base, Body, Robot

_COLOURS = (("body", "0.92 0.72 0.05 1"), ("black", "0.12 0.12 0.12 1"))


def urdf(robot: Robot) -> str:
    """Return the URDF text of a robot."""
    laser = robot.laser
    # The description has no size of the laser.
    laser_size = 0.2 * min(robot.body.size[:2])
    laser_visual = _visual((0.0, 0.0, 0.0), _cylinder(laser_size / 2, laser_size), "black")
    x, y, yaw = laser.pose
    root = _tag("robot", name=robot.name)
    for colour_name, colour_value in _COLOURS:
        root.append(_tag("material", _tag("color", rgba=colour_value), name=colour_name))
    visuals = [_body(robot.body), *_wheels(robot.base), *_casters(robot)]
    root.append(_tag("link", *visuals, name=robot.frames.base))
    root.append(_tag("link", laser_visual, name=laser.frame))

    # The joint places the laser's link on the base, at the height of the scans.
    joint = _tag(
        "joint",
        _tag("parent", link=robot.frames.base),
        _tag("child", link=laser.frame),
        _tag("origin", xyz=_words(x, y, laser.height), rpy=_words(0.0, 0.0, yaw)),
        name="laser_mount",
        type="fixed",
    )
    root.append(joint)
    return tostring(root, encoding="unicode") + "\n"


def _tag(name: str, /, *children: Element, **attributes: str) -> Element:
    element = Element(name, attributes)
    element.extend(children)
    return element


def _words(*numbers: float) -> str:
    return " ".join(map("{:g}".format, numbers))


def _body(body: Body) -> Element:
    """Return the shape of the body, a box or a cylinder."""
    length, width, height = body.size
    shape = _tag("box", size=_words(*body.size))
    if body.round:
        # URDF has no elliptic cylinder: an oval body is drawn with its mean radius.
        shape = _cylinder((length + width) / 4, height)
    return _visual((*body.centre, body.bottom + height / 2), shape, "body")


def _wheels(base: Base) -> Iterator[Element]:
    """Yield the shape of each driven wheel."""
    for x, y in geometry.wheel_places(base):
        wheel = _cylinder(base.wheel_radius, base.wheel_width)
        # A cylinder stands upright unless it is turned by 90 degrees.
        yield _visual((x, y, base.axle_height), wheel, "black", turn="1.5708 0 0")


def _casters(robot: Robot) -> Iterator[Element]:
    """Yield the shape of each caster, a ball that fills the space between ground and body."""
    base = robot.base
    ground_height = base.axle_height - base.wheel_radius
    radius = geometry.caster_radius(robot)
    for x, y in base.casters:
        ball = _tag("sphere", radius=_words(radius))
        yield _visual((x, y, ground_height + radius), ball, "black")


def _visual(
    position: Tuple[float, float, float], shape: Element, colour: str, turn: str = "0 0 0"
) -> Element:
    """Return a shape at a position (x, y, z) [m]; `turn` is roll, pitch, yaw [rad]."""
    return _tag(
        "visual",
        _tag("origin", xyz=_words(*position), rpy=turn),
        _tag("geometry", shape),
        _tag("material", name=colour),
    )


def _cylinder(radius: float, length: float) -> Element:
    return _tag("cylinder", radius=_words(radius), length=_words(length))


def main() -> None:
    """Print the model of the robot named by the first argument, by default the Jackal."""
    arguments = without_remappings()
    robot_name = "jackal"
    if arguments:
        robot_name = arguments[0]
    sys.stdout.write(urdf(load(robot_name)))
