"""The moving cylinders of DynaBARN's worlds.

Their paths are compiled into Gazebo plugins, which the world file only names. `sdf_reader` finds the key frames in the
table movers.csv beside the world: a row per key frame with the columns plugin, length, repeat, time, x, y.
docs/reference/worlds.md says how one makes it from the plugins. `generate` makes more such worlds: a room of 20 x 20 m
that people and vehicles cross, of DynaBARN's three kinds in turn, slow, medium and fast.
"""

from __future__ import annotations

import csv
import io
import math
import os
from typing import Dict, List, NamedTuple, Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common import files

from .sdf import numbers
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


def checked(length: float, repeat: bool, frames: List[Tuple[float, ...]], what: str) -> Animation:
    """An Animation whose times start at 0 or later and never fall. `what` names it in the WorldError."""
    if len(frames) < 2:
        raise WorldError(f"{what} are {len(frames)}; there must be at least 2")
    times = [row[0] for row in frames]
    if times[0] < 0.0 or any(later < earlier for earlier, later in zip(times, times[1:])) or not length > 0.0:
        raise WorldError(f"{what} must have a length above 0 and times that rise from 0; correct them")
    return Animation(length, repeat, tuple((t, x, y) for t, x, y in frames))


def read_table(path: str) -> Dict[str, Animation]:
    """{plugin: Animation} of a table. Raises WorldError with one line that names the row."""
    text = files.read_bytes(path).decode("utf-8-sig", "replace")
    rows = csv.reader(io.StringIO(text))
    groups: Dict[str, List[Tuple[float, ...]]] = {}
    heads: Dict[str, Tuple[float, bool]] = {}
    try:
        header = next(rows, [])
        if tuple(name.strip() for name in header) != COLUMNS:
            raise WorldError(f"{path} must begin with the line {','.join(COLUMNS)}")
        for row in rows:
            what = f"line {rows.line_num} of {path}"
            if not row:
                continue
            if len(row) != len(COLUMNS) or row[2].strip() not in ("0", "1"):
                raise WorldError(f"{what} must be {','.join(COLUMNS)} with repeat 0 or 1")
            plugin = row[0].strip()
            length, *frame = (numbers(cell, 1, what)[0] for cell in (row[1], *row[3:]))
            head = (length, row[2].strip() == "1")
            if heads.setdefault(plugin, head) != head:
                raise WorldError(f"{what}: length and repeat differ from the earlier rows of {plugin}")
            groups.setdefault(plugin, []).append(tuple(frame))
    except csv.Error as error:
        raise WorldError(f"{path} is no table ({error}); make it again") from None
    named = {plugin: f"key frames of {plugin} in {path}" for plugin in groups}
    return {plugin: checked(*heads[plugin], frames, named[plugin]) for plugin, frames in groups.items()}


class Animations:
    """The animations of one world's models.

    world_path  the world's file; the table lies beside it
    namespace   of the elements that our own writer puts into a world file
    """

    def __init__(self, world_path: str, namespace: str):
        self.path, self.namespace = world_path, namespace
        self._table: Optional[Dict[str, Animation]] = None

    def of(self, model: Element) -> Optional[Animation]:
        """Return a model's animation or None without a plugin. Raises WorldError where the table lacks its plugin."""
        stated = model.find(f"{{{self.namespace}}}waypoints")
        if stated is not None:
            return self._stated(stated, f"waypoints of model {model.get('name')!r} in {self.path}")
        plugin = model.find("plugin")
        name = os.path.splitext(os.path.basename("" if plugin is None else plugin.get("filename") or ""))[0]
        if plugin is None or name.startswith("libgazebo_ros_"):  # which moves nothing that nobody commands
            return None
        if self._table is None:
            table = os.path.join(os.path.dirname(os.path.abspath(self.path)), NAME)
            self._table = read_table(table) if os.path.lexists(table) else {}
        if name not in self._table:
            which = f"model {model.get('name')!r} in {self.path} has the Gazebo plugin {plugin.get('filename')!r}"
            remedy = "if it moves nothing, take it out of a copy of the world; else make that table once"
            where = f"{which}, which has no rows in {NAME} beside the world"
            raise WorldError(f"{where}: {remedy}, as docs/reference/worlds.md says")
        return self._table[name]

    def _stated(self, element: Element, what: str) -> Animation:
        """As sdf_writer puts it into a file: t x y t x y ..., with length and repeat where they are not the usual."""
        values = (element.text or "").split()
        flat = numbers(element.text, len(values) // 3 * 3, what)
        frames = [tuple(flat[i : i + 3]) for i in range(0, len(flat), 3)]
        length = frames[-1][0] if frames else 0.0
        if element.get("length") is not None:
            length = numbers(element.get("length"), 1, "length of " + what)[0]
        return checked(length, element.get("repeat") != "0", frames, what)


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
