"""Body, wheels and laser of robot.yaml: whether they can be where it says."""

from __future__ import annotations

from typing import Iterator

from applr_ros1.common.errors import ApplrError
from applr_ros1.robot_check.parameters import Setup
from sim_bridge.mechanics import mechanics


def errors(setup: Setup) -> Iterator[str]:
    """What no robot can be like."""
    base, body, laser = setup.robot.base, setup.robot.body, setup.robot.laser
    ground = base.axle_height - base.wheel_radius
    if body.bottom < ground:
        yield setup.own(
            f"base.axle_height is {base.axle_height:g}: the ground is then at {ground:.3g} m, above the body's "
            f"underside body.bottom {body.bottom:g}; give the axles' height above the base frame"
        )
    elif laser.height < ground:
        yield setup.own(f"laser.height is {laser.height:g}: that is below the ground at {ground:.3g} m, give metres")
    back, front, right, left = setup.box
    x, y, _ = laser.pose
    if max(back - x, x - front, right - y, y - left) > max(setup.size):
        yield setup.own(
            f"laser.pose is [{x:g}, {y:g}, {laser.pose[2]:g}]: body and wheels end at {front:.3g} m ahead and "
            f"{left:.3g} m to the left, give metres"
        )
    try:
        mechanics(setup.robot)
    except ApplrError as error:
        yield setup.own("body: " + str(error).partition(": ")[2])


def remarks(setup: Setup) -> Iterator[str]:
    """What looks like a slip."""
    body, laser = setup.robot.body, setup.robot.laser
    top = body.bottom + body.size[2]
    off = [abs(place - middle) for place, middle in zip(laser.pose, body.centre)]
    if body.bottom < laser.height < top and all(away < size / 2 for away, size in zip(off, body.size)):
        yield setup.own(
            f"laser.height is {laser.height:g}: the laser is then inside the body, which ends at {top:.3g} m; "
            "compare laser.pose, laser.height and body"
        )
