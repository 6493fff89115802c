"""Writer of a World as a Gazebo .world file: `python -m worlds.sdf_writer generated:7 out.world`.

Reading the file back gives the same world including its course. Gazebo ignores the elements of
namespace applr.
"""

from __future__ import annotations

import argparse
import sys
from typing import Iterable, List

import numpy as np

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError, run_main

from .sdf_reader import read_world
from .world import Mover, World

HEIGHT_M = 1.0  # height of all written obstacles [m]

_WORLD = """<?xml version="1.0"?>
<sdf version="1.6" xmlns:applr="applr">
  <world name="default">
    <include><uri>model://sun</uri></include>
    <include><uri>model://ground_plane</uri></include>
{models}    <applr:course>
      <applr:start>{start}</applr:start>
      <applr:goal>{goal}</applr:goal>
{finish}{ends}      <applr:goal_tolerance>{tolerance!r}</applr:goal_tolerance>
      <applr:path>{path}</applr:path>
    </applr:course>
  </world>
</sdf>
"""
_MODEL = """    <model name="{name}">
      <static>1</static>
      <pose>{x!r} {y!r} {z!r} 0 0 {yaw!r}</pose>{extra}
      <link name="link">
        <collision name="collision"><geometry>{shape}</geometry></collision>
        <visual name="visual"><geometry>{shape}</geometry></visual>
      </link>
    </model>
"""


def write(world: World, path: str) -> None:
    """Write `world` to `path` atomically. Raise ApplrError if the file cannot be written."""
    files.write_bytes(path, text(world).encode("utf-8"))


def text(world: World) -> str:
    """Return the text of the .world file. Numbers are written without loss of precision."""
    model_texts = []
    for number, (x, y, radius) in enumerate(world.cylinders.tolist()):
        model_texts.append(_model(f"cylinder_{number}", x, y, _cylinder(radius)))
    for number, (x, y, yaw, size_x, size_y) in enumerate(world.boxes.tolist()):
        box_xml = f"<box><size>{size_x!r} {size_y!r} {HEIGHT_M!r}</size></box>"
        model_texts.append(_model(f"box_{number}", x, y, box_xml, yaw))
    for number, mover in enumerate(world.movers):
        _, x, y = mover.waypoints[0]
        shape_xml = _cylinder(mover.radius)
        model_texts.append(_model(f"mover_{number}", x, y, shape_xml, extra=_waypoints(mover)))

    course = world.course
    finish_xml = ""
    ends_xml = ""
    if course.finish_y is not None:
        finish_xml = f"      <applr:finish_y>{float(course.finish_y)!r}</applr:finish_y>\n"
    if course.planner_ends:
        ends_xml = "      <applr:planner_ends/>\n"
    return _WORLD.format(
        models="".join(model_texts),
        start=_row(course.start),
        goal=_row(course.goal),
        finish=finish_xml,
        ends=ends_xml,
        tolerance=float(course.goal_tolerance),
        path=_row(course.path.ravel().tolist()),
    )


def _model(name: str, x: float, y: float, shape: str, yaw: float = 0.0, extra: str = "") -> str:
    # A model stands on the ground, and its pose is the pose of its centre.
    z = 0.5 * HEIGHT_M
    return _MODEL.format(name=name, x=x, y=y, z=z, yaw=yaw, shape=shape, extra=extra)


def _cylinder(radius: float) -> str:
    return f"<cylinder><radius>{radius!r}</radius><length>{HEIGHT_M!r}</length></cylinder>"


def _waypoints(mover: Mover) -> str:
    """Return the element with the key frames of a moving obstacle."""
    # Defaults are not written.
    attributes = ""
    if mover.length != mover.waypoints[-1][0]:
        attributes += f' length="{mover.length!r}"'
    if not mover.repeat:
        attributes += ' repeat="0"'
    if mover.looks:
        attributes += ' looks="1"'
    frames_text = " ".join(_row(frame) for frame in mover.waypoints)
    return f"\n      <applr:waypoints{attributes}>{frames_text}</applr:waypoints>"


def _row(values: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in values)


def main() -> int:
    """Write a world. Return exit status 1 if reading or writing fails."""
    from . import command_line  # It imports all that describes robots, which `write` does not need.

    parser = argparse.ArgumentParser(
        prog="python -m worlds.sdf_writer",
        description="Write a world as a Gazebo world file, which reads back as the same world.",
    )
    command_line.add_arguments(parser)
    parser.add_argument("file", help="File to write, such as out.world.")
    parser.add_argument(
        "--course",
        nargs="+",
        type=float,
        metavar="X Y",
        help="Course of a .world file, from start to goal [m].",
    )
    arguments = parser.parse_args()

    # Reading takes place within run_main, which reports an error in one line.
    def write_world() -> None:
        if arguments.course is None:
            world = command_line.named_world(arguments)
        else:
            world = with_course(arguments.world, arguments.course)
        write(world, arguments.file)

    return run_main(write_world, "sdf_writer")


def with_course(path: str, numbers: List[float]) -> World:
    """Return the world of a .world file with a course along points [x, y, x, y, ...] [m]."""
    if len(numbers) % 2 or not path.endswith(".world"):
        raise ApplrError(
            f"{path}: --course does not fit; give X Y X Y ... for a .world file, "
            "two numbers for each point"
        )
    return read_world(path, np.array(numbers).reshape(-1, 2))


if __name__ == "__main__":
    sys.exit(main())
