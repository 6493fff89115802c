"""A World as a Gazebo .world file: `python -m worlds.sdf_writer generated:7 out.world`.

Reading it back gives the same world, course included; Gazebo itself passes over our own two elements (namespace applr).
"""

from __future__ import annotations

import argparse
import sys
from typing import Iterable, List, Optional

import numpy as np

from applr_ros1.common import files
from applr_ros1.common.errors import run_main

from .loading import SPECIFICATIONS, load
from .sdf_reader import read_world
from .world import Mover, World, WorldError

HEIGHT_M = 1.0  # of everything written [m]

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
    """Writes `world` to `path`, whole or not at all. WorldError when that cannot be done."""
    files.write_bytes(path, text(world).encode("utf-8"))


def text(world: World) -> str:
    """The .world file's text. Numbers are written so that they read back to the last bit."""
    models: List[str] = []

    def add(name, x, y, shape, yaw=0.0, extra=""):
        models.append(_MODEL.format(name=name, x=x, y=y, z=0.5 * HEIGHT_M, yaw=yaw, shape=shape, extra=extra))

    def cylinder(radius):
        return f"<cylinder><radius>{radius!r}</radius><length>{HEIGHT_M!r}</length></cylinder>"

    for n, (x, y, radius) in enumerate(world.cylinders.tolist()):
        add(f"cylinder_{n}", x, y, cylinder(radius))
    for n, (x, y, yaw, size_x, size_y) in enumerate(world.boxes.tolist()):
        add(f"box_{n}", x, y, f"<box><size>{size_x!r} {size_y!r} {HEIGHT_M!r}</size></box>", yaw)
    for n, mover in enumerate(world.movers):
        add(f"mover_{n}", *mover.waypoints[0][1:], cylinder(mover.radius), extra=_waypoints(mover))
    course = world.course
    finish = "" if course.finish_y is None else f"      <applr:finish_y>{float(course.finish_y)!r}</applr:finish_y>\n"
    ends = "      <applr:planner_ends/>\n" if course.planner_ends else ""
    start, goal, path = map(_row, (course.start, course.goal, course.path.ravel().tolist()))
    ways = dict(start=start, goal=goal, path=path, finish=finish, ends=ends, tolerance=float(course.goal_tolerance))
    return _WORLD.format(models="".join(models), **ways)


def _waypoints(mover: Mover) -> str:
    length = f' length="{mover.length!r}"' if mover.length != mover.waypoints[-1][0] else ""
    repeat = "" if mover.repeat else ' repeat="0"'
    frames = _row(v for point in mover.waypoints for v in point)
    return f"\n      <applr:waypoints{length}{repeat}>{frames}</applr:waypoints>"


def _row(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def main() -> int:
    """Exit status 1 and one line where a world cannot be read or written."""
    parser = argparse.ArgumentParser(
        prog="python -m worlds.sdf_writer",
        description="Writes a world as a Gazebo world file, which reads back as the same world.",
    )
    add = parser.add_argument
    add("world", help=f"World to write: {SPECIFICATIONS}.")
    add("file", help="File to write, such as out.world.")
    add("--course", nargs="+", type=float, metavar="X Y", help="For a .world file: its course, start to goal [m].")
    arguments = parser.parse_args()
    return run_main(lambda: write(_world(arguments.world, arguments.course), arguments.file), "sdf_writer")


def _world(name: str, course: Optional[List[float]]) -> World:
    if course is None:
        return load(name)
    if len(course) % 2 or not name.endswith(".world"):
        raise WorldError(f"{name}: give --course X Y X Y ... for a .world file, two numbers for each place")
    return read_world(name, np.array(course).reshape(-1, 2))


if __name__ == "__main__":
    sys.exit(main())
