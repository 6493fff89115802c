"""Moving cylinders of DynaBARN worlds.

DynaBARN compiles the paths of its cylinders into Gazebo plugins, and a world file only names the plugins. `sdf_reader`
takes the key frames from the table movers.csv beside the world, with one row per key frame and the columns plugin,
length, repeat, time, x, y. docs/reference/worlds.md describes how to make the table. `generate` returns further worlds:
a room of 20 x 20 m with moving cylinders, alternately of DynaBARN's slow, medium and fast kinds.
"""

from __future__ import annotations

import csv
import functools
import math
import os
from typing import Callable, Dict, List, Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common.errors import ApplrError

from .sdf import NAMESPACE, numbers
from .world import Course, KeyFrame, Mover, World

START, GOAL = (11.0, 0.0, math.pi), (-9.0, 0.0, math.pi)  # poses of the BARN Challenge, 20 m along -x
GOAL_TOLERANCE_M = 1.0  # goal tolerance of the BARN Challenge [m]

NAME = "movers.csv"
COLUMNS = ("plugin", "length", "repeat", "time", "x", "y")
Animation = Callable[[float], Mover]  # returns the moving cylinder for a radius [m]


@functools.lru_cache(maxsize=4)
def read_table(path: str) -> Dict[str, Animation]:
    """Return the animations of a table by plugin."""
    heads: Dict[str, Tuple[float, bool]] = {}
    frames: Dict[str, List[KeyFrame]] = {}
    with open(path, newline="", encoding="utf-8-sig") as file:
        for row in csv.DictReader(file):
            heads[row["plugin"]] = float(row["length"]), row["repeat"] == "1"
            frame = float(row["time"]), float(row["x"]), float(row["y"])
            frames.setdefault(row["plugin"], []).append(frame)
    return {plugin: _animation(*heads[plugin], rows) for plugin, rows in frames.items()}


def _animation(length: float, repeat: bool, frames: List[KeyFrame]) -> Animation:
    return functools.partial(Mover, waypoints=tuple(frames), length=length, repeat=repeat)


def animation_of(model: Element, path: str) -> Optional[Animation]:
    """Return the animation of a model in the world file `path`, or None if the model has no plugin.

    Raises:
        ApplrError: The table beside the file has no rows of the plugin.
    """
    stored = model.find(f"{{{NAMESPACE}}}waypoints")
    if stored is not None:
        count = len((stored.text or "").split()) // 3 * 3
        flat = numbers(stored.text, count, f"waypoints of model {model.get('name')!r} in {path}")
        frames = [(flat[i], flat[i + 1], flat[i + 2]) for i in range(0, count, 3)]
        return _animation(float(stored.get("length", 0.0)), stored.get("repeat") != "0", frames)
    plugin = model.find("plugin")
    name = os.path.splitext(os.path.basename("" if plugin is None else plugin.get("filename") or ""))[0]
    if plugin is None or name.startswith("libgazebo_ros_"):  # These plugins move a model only on command.
        return None
    table = os.path.join(os.path.dirname(os.path.abspath(path)), NAME)
    animations = read_table(table) if os.path.lexists(table) else {}
    if name not in animations:
        which = f"model {model.get('name')!r} in {path} has the Gazebo plugin {plugin.get('filename')!r}"
        remedy = "if the plugin moves nothing, remove it from a copy of the world; otherwise make that table once"
        where = f"{which}, which has no rows in {NAME} beside the world"
        raise ApplrError(f"{where}: {remedy}, as docs/reference/worlds.md describes")
    return animations[name]


def arena_course(planner_ends: bool = False) -> Course:
    """Return DynaBARN's course: 20 m straight through the arena, with a goal tolerance of 1 m."""
    path = np.column_stack([np.linspace(START[0], GOAL[0], 41), np.zeros(41)])
    return Course(START, GOAL, None, GOAL_TOLERANCE_M, path, planner_ends)


SPLITS = {"test": range(50), "validation": range(50, 100)}  # numbers by split; 100 and up are free for training
SPEEDS_M_S = ((0.3, 0.95), (0.8, 1.5), (1.4, 1.95))  # speed range of each kind [m/s]
MOVER_COUNTS = ((6, 12), (8, 18), (10, 24))  # range of the number of moving obstacles in each kind of world
RADII_M = (0.25, 0.5)  # radius range, from a person to DynaBARN's cylinders [m]
HALF_SIDE_M, WALL_WIDTH_M = 10.0, 0.5  # half the side length of the room, and thickness of its walls [m]
WALLS = np.array(
    [
        [-HALF_SIDE_M, 0, 0, WALL_WIDTH_M, 2 * HALF_SIDE_M],
        [0, HALF_SIDE_M, 0, 2 * HALF_SIDE_M, WALL_WIDTH_M],
        [0, -HALF_SIDE_M, 0, 2 * HALF_SIDE_M, WALL_WIDTH_M],
    ]
)
SEED = 20220601


def generate(number: int) -> World:
    """Return world `number` >= 0."""
    rng = np.random.default_rng([SEED, number])
    kind = number % len(SPEEDS_M_S)
    count = int(rng.integers(MOVER_COUNTS[kind][0], MOVER_COUNTS[kind][1] + 1))
    movers = tuple(_mover(rng, SPEEDS_M_S[kind]) for _ in range(count))
    return World(f"dynamic:{number}", np.empty((0, 3)), WALLS, arena_course(planner_ends=True), movers)


def _mover(rng: np.random.Generator, speeds: Tuple[float, float]) -> Mover:
    """Draw a cylinder that crosses the room from wall to wall, with a new speed on each leg."""
    first, last = (_at_a_wall(rng, wall) for wall in rng.choice(4, 2, replace=False))
    between = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(1, 6))))
    way = [first] + [first + u * (last - first) + rng.normal(0.0, 2.0, 2) for u in between] + [last]
    points = np.clip(way, -HALF_SIDE_M, HALF_SIDE_M)
    frames: List[KeyFrame] = [(0.0, float(points[0][0]), float(points[0][1]))]
    for before, after in zip(points[:-1], points[1:]):
        took = max(math.hypot(*(after - before)), 0.05) / rng.uniform(*speeds)
        frames.append((frames[-1][0] + took, float(after[0]), float(after[1])))
    return Mover(float(rng.uniform(*RADII_M)), tuple(frames))


def _at_a_wall(rng: np.random.Generator, wall: int) -> np.ndarray:
    """Draw a point (2,) [m] on one of the four walls."""
    along, side = rng.uniform(-0.9 * HALF_SIDE_M, 0.9 * HALF_SIDE_M), HALF_SIDE_M if wall % 2 else -HALF_SIDE_M
    return np.array([side, along] if wall < 2 else [along, side])
