"""DynaBARN's moving cylinders. Their paths are compiled into Gazebo plugins, named in the world file only; this finds
the waypoints in a plugin's source beside the world, or draws its own by DynaBARN's recipe. `sdf_reader` calls it.
"""

from __future__ import annotations

import logging
import math
import os
import re
import zlib
from typing import Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from .sdf_xml import FAR, numbers, read_bytes
from .world import Course, WorldError

Waypoints = Tuple[Tuple[float, float, float], ...]

SIDE = 10.0  # the arena reaches 10 m from its middle each way
# 20 m, heading -x. The goal lies .3 m short of that: the planner's map ends 20 m from the start, and its border is shut
START, GOAL = (11.0, 0.0, math.pi), (-8.7, 0.0, math.pi)
GOAL_TOLERANCE = 1.0  # as in the BARN Challenge: odometry drifts by decimetres over 20 m
FOLDERS = ("", "plugins", "all_cylinder_plugins")  # where sources may lie, beside the world
MAX_SOURCE = 2**20
MAX_WAYPOINTS = 1000

_KEY = re.compile(r"CreateKeyFrame\(\s*([-+.\deE]+)\s*\).*?Vector3d\(\s*([-+.\deE]+)\s*,\s*([-+.\deE]+)\s*,", re.S)

log = logging.getLogger(__name__)
_warned = set()  # worlds of which it was said already


def waypoints_of(model: Element, world_path: str, namespace: str) -> Optional[Waypoints]:
    """((t, x, y), ...) of a moving model, None for one that stands still."""
    stated = model.find("{%s}waypoints" % namespace)
    if stated is not None:
        values = (stated.text or "").split()
        what = "waypoints of model %r in %s" % (model.get("name"), world_path)
        rows = np.array(numbers(stated.text, len(values) // 3 * 3, what)).reshape(-1, 3)
        return _checked(rows, what)
    for plugin in model.findall("plugin"):
        stem = os.path.splitext(plugin.get("filename") or "")[0]
        if re.match(r"^(lib)?obs_?\d+$", stem):
            return _from_source(stem, world_path) or _drawn(stem, world_path)
    return None


def _from_source(stem: str, world_path: str) -> Optional[Waypoints]:
    here = os.path.dirname(os.path.abspath(world_path))
    for folder in FOLDERS:
        source = os.path.join(here, folder, stem + ".cc")
        if os.path.isfile(source):
            text = read_bytes(source, MAX_SOURCE).decode("utf-8", "replace")
            try:
                rows = np.array([[float(v) for v in match] for match in _KEY.findall(text)]).reshape(-1, 3)
            except ValueError:
                rows = np.zeros((0, 3))
            return _checked(rows, "key frames in %s" % source)
    return None


def _checked(rows: np.ndarray, what: str) -> Waypoints:
    """Times from 0, rising. Key frames at one time (DynaBARN rounds to .01 s) are one."""
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) != 0.0])] if len(rows) else rows
    if not 2 <= len(rows) <= MAX_WAYPOINTS:
        raise WorldError("%s are %d; there must be 2 to %d" % (what, len(rows), MAX_WAYPOINTS))
    if not np.all(np.abs(rows) <= FAR) or rows[0, 0] != 0.0 or np.any(np.diff(rows[:, 0]) <= 0.0):
        raise WorldError("%s must be finite, with times that rise from 0; correct them" % what)
    return tuple(tuple(float(v) for v in row) for row in rows)


def _drawn(stem: str, world_path: str) -> Waypoints:
    """A random polynomial across the arena, the same for a plugin's name every time."""
    if world_path not in _warned:
        _warned.add(world_path)
        log.warning(
            "%s: the source of plugin %s (and perhaps of others) is not beside it: its cylinder moves on a "
            "trajectory drawn from DynaBARN's recipe; put %s.cc there for the original",
            world_path,
            stem,
            stem,
        )
    rng = np.random.default_rng(zlib.crc32(stem.encode()))
    while True:
        order = int(rng.integers(1, 4))
        ends = rng.choice(np.arange(-10, 11), size=order + 1, replace=False)
        polynomial = np.polyfit(ends, rng.integers(-10, 11, size=order + 1), order)
        x = np.linspace(-SIDE, SIDE, 41)
        y = np.polyval(polynomial, x)
        inside = np.flatnonzero(np.abs(y) <= SIDE)
        if len(inside) >= 10 and inside[-1] - inside[0] == len(inside) - 1:
            break
    points = np.column_stack([x, y])[inside][:: 1 if rng.random() < 0.5 else -1]
    speed = np.clip(rng.normal(rng.uniform(0.4, 1.2), 0.2, size=len(points) - 1), 0.2, 2.0)
    times = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T) / speed)])
    return tuple((float(t), float(a), float(b)) for t, (a, b) in zip(times, points))


def arena_course() -> Course:
    """DynaBARN's course: 20 m straight through the arena. Its reference path is the straight line."""
    path = np.column_stack([np.linspace(START[0], GOAL[0], 41), np.zeros(41)])
    return Course(start=START, goal=GOAL, finish_y=None, goal_tolerance=GOAL_TOLERANCE, path=path)
