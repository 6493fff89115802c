"""The costmaps: footprint, frames, size, and whether the scans of the robot's laser reach them."""

from __future__ import annotations

from typing import Any, Dict, Iterator

import numpy as np

from applr_ros1.planner.parameters.layers import COSTMAPS, INFLATION_LAYER, STATIC_LAYER
from applr_ros1.robot_check.parameters import Setup

UNITS = 10.0  # a length that is so many times another one is in centimetres or millimetres
WIDTH = 0.53  # of the Jackal's padded footprint [m], for which the recipe of the worlds was made
SCALE_OFF = 0.15  # share by which world_scale may differ from the one that follows from the footprint
OUTSIDE = 0.01  # m by which body and wheels may reach beyond the padded footprint


def errors(setup: Setup) -> Iterator[str]:
    """What no drive could succeed with."""
    for costmap in COSTMAPS:
        yield from _footprint(setup, costmap)
        yield from _frames(setup, costmap)
        yield from _scans(setup, costmap)
        yield from _size(setup, costmap)


def _footprint(setup: Setup, costmap: str) -> Iterator[str]:
    own, (length, width) = setup.full[costmap], setup.size
    back, front, right, left = setup.box
    box = (
        f"[[{back:.3g}, {right:.3g}], [{back:.3g}, {left:.3g}], [{front:.3g}, {left:.3g}], [{front:.3g}, {right:.3g}]]"
    )
    if not {"footprint", "robot_radius"} & set(setup.tree.get(costmap, {})):
        yield setup.placed(f"{costmap}/footprint is missing: body and wheels fill {box}, give that")
        return
    key = "footprint" if len(setup.outline(costmap)) != 16 else "robot_radius"
    reach = np.ptp(setup.outline(costmap), axis=0)
    if abs(own["footprint_padding"]) > length:
        key = "footprint_padding"
    if not 1 / UNITS < reach[1] / width < UNITS:
        yield setup.placed(
            f"{costmap}/{key} is {own[key]!s:.60}: with padding that is {reach[0]:.3g} x {reach[1]:.3g} m, body and "
            f"wheels are {length:.3g} x {width:.3g} m, give metres"
        )
    for layer in setup.layers(costmap, INFLATION_LAYER):
        radius = own[layer.name]["inflation_radius"]
        if radius > 2 * UNITS * width:
            yield setup.placed(
                f"{layer.path}/inflation_radius is {radius:g}: the robot is {width:.3g} m wide, give metres"
            )


def _frames(setup: Setup, costmap: str) -> Iterator[str]:
    own, frames = setup.full[costmap], setup.robot.frames
    wanted = {"robot_base_frame": ("base", frames.base), "global_frame": ("odom", frames.odom)}
    if setup.with_map:
        wanted["global_frame"] = ("map", frames.map)
    for key, (field, frame) in wanted.items():
        if setup.with_map and costmap == "local_costmap" and key == "global_frame":
            continue
        if own[key].lstrip("/") != frame.lstrip("/"):
            given = own[key] if key in setup.tree.get(costmap, {}) else f"not given, which means {own[key]}"
            yield setup.placed(f"{costmap}/{key} is {given}: frames.{field} in robot.yaml is {frame}, give that")
    for layer in setup.layers(costmap, STATIC_LAYER) if not setup.with_map else ():
        yield setup.placed(f"{costmap}/plugins has {layer.name}: there is no map here, leave it out in without_map")


def _scans(setup: Setup, costmap: str) -> Iterator[str]:
    """Whether the robot's laser marks obstacles in a costmap."""
    found = list(setup.sources(costmap))
    if not found:
        if costmap == "local_costmap":
            yield setup.placed("local_costmap has no observation source: the robot would not see obstacles, give one")
        return
    problems = [list(_blind(setup, path, own)) for path, own in found]
    if all(problems):
        yield setup.placed(problems[0][0])


def _blind(setup: Setup, path: str, source: Dict[str, Any]) -> Iterator[str]:
    """Why a source does not show what the laser sees."""
    scan, laser = setup.robot.topics.scan, setup.robot.laser
    if source["topic"].strip("/") != scan.strip("/"):
        yield f"{path}/topic is {source['topic']}: topics.scan in robot.yaml is {scan}, give that"
    if source["data_type"] != "LaserScan":
        yield f"{path}/data_type is {source['data_type']}: the laser of robot.yaml publishes LaserScan, give that"
    if not source["marking"]:
        yield f"{path}/marking is false: nothing would mark obstacles, give true"
    for key, above in (("min_obstacle_height", False), ("max_obstacle_height", True)):
        if (source[key] < laser.height) if above else (source[key] > laser.height):
            height = f"laser.height in robot.yaml is {laser.height:g}"
            yield f"{path}/{key} is {source[key]:g}: {height}, so that all points are dropped"


def _size(setup: Setup, costmap: str) -> Iterator[str]:
    own, width = setup.full[costmap], setup.size[1]
    if own["resolution"] > width:
        yield setup.placed(
            f"{costmap}/resolution is {own['resolution']:g}: the robot is {width:.3g} m wide, give metres"
        )
    if costmap == "local_costmap" and own["update_frequency"] == 0.0:
        yield setup.placed(f"{costmap}/update_frequency is 0: the costmap is never updated, give that of the scans")
    for side, origin in (("width", "origin_x"), ("height", "origin_y")):
        if not (setup.with_map or own["rolling_window"]) and not own[origin] < 0.0 < own[origin] + own[side]:
            yield setup.placed(
                f"{costmap}/{origin} is {own[origin]:g}: the costmap, {own[side]:g} m long, does not hold the robot's "
                f"start at 0, give {-own[side] / 2:g}, or rolling_window: true"
            )


def remarks(setup: Setup) -> Iterator[str]:
    """What will not drive well."""
    robot = setup.robot
    outline = setup.outline("local_costmap")
    fitting = np.ptp(outline, axis=0)[1] / WIDTH
    if abs(robot.world_scale / fitting - 1.0) > SCALE_OFF:
        yield setup.own(
            f"world_scale is {robot.world_scale:g}: by the footprint's width it is {fitting:.3f}, give that"
        )
    low_x, high_x, low_y, high_y = setup.box
    beyond = max(*(outline.min(axis=0) - (low_x, low_y)), *((high_x, high_y) - outline.max(axis=0)))
    if beyond > OUTSIDE:
        yield setup.placed(
            f"local_costmap/footprint is too small: body and wheels reach {beyond:.2f} m beyond it, padded"
        )
    for costmap in COSTMAPS:
        for path, source in setup.sources(costmap):
            frame = source["sensor_frame"].lstrip("/")
            if source["topic"].strip("/") == robot.topics.scan.strip("/") and frame not in ("", robot.laser.frame):
                wanted = f"laser.frame in robot.yaml is {robot.laser.frame}"
                yield setup.placed(f"{path}/sensor_frame is {frame}: {wanted}, give that or leave it out")
            if source["obstacle_range"] > source["raytrace_range"]:
                yield setup.placed(
                    f"{path}/obstacle_range is {source['obstacle_range']:g}: what is marked beyond raytrace_range "
                    f"{source['raytrace_range']:g} is never cleared, give at most that"
                )
