"""The moving cylinders of DynaBARN's worlds.

Their paths are compiled into Gazebo plugins, which the world file only names. `sdf_reader` finds the key frames in the
table movers.csv beside the world: a row per key frame with the columns plugin, length, repeat, time, x, y.
docs/reference/worlds.md says how one makes it from the plugins. `generate` makes more such worlds: a room of 20 x 20 m
that people and vehicles cross, of DynaBARN's three kinds in turn, slow, medium and fast.
"""

from __future__ import annotations

import csv
import functools
import math
import os
from typing import Dict, List, NamedTuple, Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from .sdf import NAMESPACE, numbers
from .world import Course, KeyFrame, Mover, World, WorldError

START, GOAL = (11.0, 0.0, math.pi), (-9.0, 0.0, math.pi)  # the BARN Challenge's: 20 m, heading -x
GOAL_TOLERANCE_M = 1.0  # also the Challenge's

NAME = "movers.csv"
COLUMNS = ("plugin", "length", "repeat", "time", "x", "y")


class Animation(NamedTuple):
    """length [s], whether it starts again after that, and its key frames ((t, x, y), ...) [s, m, m]."""

    length: float
    repeat: bool
    frames: Tuple[Tuple[float, float, float], ...]


@functools.lru_cache(maxsize=4)
def read_table(path: str) -> Dict[str, Animation]:
    """Return {plugin: Animation} of a table."""
    heads: Dict[str, Tuple[float, bool]] = {}
    frames: Dict[str, List[KeyFrame]] = {}
    with open(path, newline="", encoding="utf-8-sig") as file:
        for row in csv.DictReader(file):
            heads[row["plugin"]] = float(row["length"]), row["repeat"] == "1"
            frame = float(row["time"]), float(row["x"]), float(row["y"])
            frames.setdefault(row["plugin"], []).append(frame)
    return {plugin: Animation(*heads[plugin], tuple(rows)) for plugin, rows in frames.items()}


def animation_of(model: Element, path: str) -> Optional[Animation]:
    """Return the animation of a model in the world file `path`, None if it has no plugin.

    Raises WorldError if the table beside the file has no rows of the plugin.
    """
    stated = model.find(f"{{{NAMESPACE}}}waypoints")
    if stated is not None:
        count = len((stated.text or "").split()) // 3 * 3
        flat = numbers(stated.text, count, f"waypoints of model {model.get('name')!r} in {path}")
        frames = tuple((flat[i], flat[i + 1], flat[i + 2]) for i in range(0, count, 3))
        return Animation(float(stated.get("length") or frames[-1][0]), stated.get("repeat") != "0", frames)
    plugin = model.find("plugin")
    name = os.path.splitext(os.path.basename("" if plugin is None else plugin.get("filename") or ""))[0]
    if plugin is None or name.startswith("libgazebo_ros_"):  # which moves nothing that nobody commands
        return None
    table = os.path.join(os.path.dirname(os.path.abspath(path)), NAME)
    animations = read_table(table) if os.path.lexists(table) else {}
    if name not in animations:
        which = f"model {model.get('name')!r} in {path} has the Gazebo plugin {plugin.get('filename')!r}"
        remedy = "if it moves nothing, take it out of a copy of the world; else make that table once"
        where = f"{which}, which has no rows in {NAME} beside the world"
        raise WorldError(f"{where}: {remedy}, as docs/reference/worlds.md says")
    return animations[name]


def arena_course(planner_ends: bool = False) -> Course:
    """DynaBARN's course: 20 m straight through the arena, done within 1 m. Its reference path is the straight line."""
    path = np.column_stack([np.linspace(START[0], GOAL[0], 41), np.zeros(41)])
    return Course(START, GOAL, None, GOAL_TOLERANCE_M, path, planner_ends)


SPLITS = {"test": range(50), "validation": range(50, 100)}  # numbers from 100 on are free for training
SPEEDS_M_S = ((0.3, 0.95), (0.8, 1.5), (1.4, 1.95))  # of the three kinds [m/s]
MOVER_COUNTS = ((6, 12), (8, 18), (10, 24))  # of their movers
RADII_M = (0.25, 0.5)  # of a person, and of DynaBARN's cylinders [m]
HALF_SIDE_M, WALL_WIDTH_M = 10.0, 0.5  # half the room's side and the thickness of its walls [m]
WALLS = np.array(
    [
        [-HALF_SIDE_M, 0, 0, WALL_WIDTH_M, 2 * HALF_SIDE_M],
        [0, HALF_SIDE_M, 0, 2 * HALF_SIDE_M, WALL_WIDTH_M],
        [0, -HALF_SIDE_M, 0, 2 * HALF_SIDE_M, WALL_WIDTH_M],
    ]
)
SEED = 20220601


def generate(number: int) -> World:
    """World `number`; any number >= 0 gives one."""
    rng = np.random.default_rng([SEED, number])
    kind = number % len(SPEEDS_M_S)
    count = int(rng.integers(MOVER_COUNTS[kind][0], MOVER_COUNTS[kind][1] + 1))
    movers = tuple(_mover(rng, SPEEDS_M_S[kind]) for _ in range(count))
    return World(f"dynamic:{number}", np.empty((0, 3)), WALLS, arena_course(planner_ends=True), movers)


def _mover(rng: np.random.Generator, speeds) -> Mover:
    """A cylinder from one wall to another through some points of the room, whose pace changes from leg to leg."""
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
    along, side = rng.uniform(-0.9 * HALF_SIDE_M, 0.9 * HALF_SIDE_M), HALF_SIDE_M if wall % 2 else -HALF_SIDE_M
    return np.array([side, along] if wall < 2 else [along, side])
