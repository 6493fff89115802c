"""A World as a Gazebo .world file: `python -m worlds.sdf_writer generated:7 out.world`.

Reading it back gives the same world, course included; Gazebo itself passes over our own two elements (namespace applr).
"""

from __future__ import annotations

import argparse
import sys
from typing import Iterable, List

from applr_ros1.common import files
from applr_ros1.common.errors import run_main

from .loading import FORMS, load
from .world import Course, Mover, World

HEIGHT = 1.0  # of everything written [m]

_HEAD = """<?xml version="1.0"?>
<sdf version="1.6" xmlns:applr="applr">
  <world name="default">
    <include><uri>model://sun</uri></include>
    <include><uri>model://ground_plane</uri></include>
"""
_TAIL = """  </world>
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
    for n, (x, y, radius) in enumerate(world.cylinders.tolist()):
        models.append(_model(f"cylinder_{n}", x, y, 0.0, _cylinder(radius)))
    for n, (x, y, yaw, size_x, size_y) in enumerate(world.boxes.tolist()):
        shape = "<box><size>{!r} {!r} {!r}</size></box>".format(size_x, size_y, HEIGHT)
        models.append(_model(f"box_{n}", x, y, yaw, shape))
    for n, mover in enumerate(world.movers):
        _, x, y = mover.waypoints[0]
        models.append(_model(f"mover_{n}", x, y, 0.0, _cylinder(mover.radius), _waypoints(mover)))
    return _HEAD + "".join(models) + _course(world.course) + _TAIL


def _model(name: str, x: float, y: float, yaw: float, shape: str, extra: str = "") -> str:
    return _MODEL.format(name=name, x=x, y=y, z=0.5 * HEIGHT, yaw=yaw, shape=shape, extra=extra)


def _cylinder(radius: float) -> str:
    return "<cylinder><radius>{!r}</radius><length>{!r}</length></cylinder>".format(radius, HEIGHT)


def _waypoints(mover: Mover) -> str:
    length = f' length="{mover.length!r}"' if mover.length != mover.waypoints[-1][0] else ""
    repeat = "" if mover.repeat else ' repeat="0"'
    frames = _row(v for point in mover.waypoints for v in point)
    return f"\n      <applr:waypoints{length}{repeat}>{frames}</applr:waypoints>"


def _course(course: Course) -> str:
    finish = "" if course.finish_y is None else f"      <applr:finish_y>{float(course.finish_y)!r}</applr:finish_y>\n"
    return f"""    <applr:course>
      <applr:start>{_row(course.start)}</applr:start>
      <applr:goal>{_row(course.goal)}</applr:goal>
{finish}      <applr:goal_tolerance>{float(course.goal_tolerance)!r}</applr:goal_tolerance>
      <applr:path>{_row(course.path.ravel().tolist())}</applr:path>
    </applr:course>
"""


def _row(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def main() -> int:
    """Exit status 1 and one line where a world cannot be read or written."""
    parser = argparse.ArgumentParser(
        prog="python -m worlds.sdf_writer",
        description="Writes a world as a Gazebo world file, which reads back as the same world.",
    )
    parser.add_argument("world", help=f"World to write: {FORMS}.")
    parser.add_argument("file", help="File to write, such as out.world.")
    arguments = parser.parse_args()
    return run_main(lambda: write(load(arguments.world), arguments.file), "sdf_writer")


if __name__ == "__main__":
    sys.exit(main())
