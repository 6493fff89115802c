"""What a description may not say against itself: a base without an axle, a laser that sees nothing.

reader.py calls `problems` last.
"""

from __future__ import annotations

from math import pi
from typing import Iterator

from applr_ros1.robots.description import Robot


def problems(robot: Robot) -> Iterator[str]:
    """A line for each contradiction in a description."""
    yield from _base(robot)
    yield from _ground(robot)
    yield from _laser(robot)
    for name, limit in (("deceleration", "max_acceleration"), ("yaw_deceleration", "max_yaw_acceleration")):
        asked, most = getattr(robot.monitor, name), getattr(robot.base, limit)
        if asked > most:
            yield f"monitor.{name} is {asked:g}: the base brakes with base.{limit} {most:g}, give at most that"


def _base(robot: Robot) -> Iterator[str]:
    base = robot.base
    if base.drive == "skid_steer" and base.wheelbase == 0.0:
        yield "base.wheelbase is missing: a skid_steer base has two axles, give their distance"
    if base.drive == "two_wheel" and base.wheelbase != 0.0:
        yield f"base.wheelbase is {base.wheelbase:g}: a two_wheel base has one axle, leave it out"
    if base.drive == "skid_steer" and base.casters:
        yield "base.casters: a skid_steer base has none, leave them out"
    if base.drive == "two_wheel" and not base.casters:
        yield "base.casters is missing: a two_wheel base stands on one at least, give where they touch the ground"


def _ground(robot: Robot) -> Iterator[str]:
    if robot.simulation.ground == "gazebo":
        if robot.base.drive != "skid_steer":
            yield "simulation.ground is gazebo: it is for a skid_steer base, give plain"
        if robot.simulation.track_multiplier is None:
            yield "simulation.track_multiplier is missing: ground gazebo needs the one of the wheels' controller"


def _laser(robot: Robot) -> Iterator[str]:
    laser = robot.laser
    if not laser.first_angle < laser.last_angle:
        yield f"laser.last_angle is {laser.last_angle:g}: give more than first_angle {laser.first_angle:g}"
    elif laser.last_angle - laser.first_angle > 2 * pi + 1e-3:
        yield (
            f"laser.last_angle is {laser.last_angle:g}: from first_angle {laser.first_angle:g} that is more than a "
            "full turn"
        )
    if not laser.range_min < laser.range_max:
        yield f"laser.range_max is {laser.range_max:g}: give more than range_min {laser.range_min:g}"
    elif laser.no_return is not None and laser.range_min <= laser.no_return < laser.range_max:
        yield f"laser.no_return is {laser.no_return:g}: between range_min and range_max it would hide obstacles"
