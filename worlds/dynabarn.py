"""The moving cylinders of DynaBARN's worlds.

Their paths are compiled into Gazebo plugins, which the world file only names. This finds the key frames in the table
movers.csv or in a plugin's source beside the world, or draws a path by DynaBARN's recipe. `sdf_reader` calls it.
"""

from __future__ import annotations

import logging
import math
import os
import re
import zlib
from typing import Dict, List, Optional, Set, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common import files

from . import movers_table
from .movers_table import Animation
from .sdf_xml import numbers
from .world import Course, WorldError

SIDE = 10.0  # the arena reaches 10 m from its middle each way
START, GOAL = (11.0, 0.0, math.pi), (-9.0, 0.0, math.pi)  # the BARN Challenge's: 20 m, heading -x
GOAL_TOLERANCE = 1.0  # also the Challenge's
FOLDERS = ("", "plugins", "all_cylinder_plugins")  # where sources may lie, beside the world
MAX_SOURCE = 2**20

_CALL = re.compile(
    r"CreateKeyFrame\(\s*([-+.\deE]+)\s*\)|Vector3d\(\s*([-+.\deE]+)\s*,\s*([-+.\deE]+)\s*,"
)  # a key frame's time, or a place
_DYNABARNS = re.compile(r"^(easy|medium|hard)?(lib)?obs_?\d+$")

log = logging.getLogger(__name__)
_warned: Set[str] = set()  # worlds that were warned of already


class Animations:
    """The animations of one world's models. Ask for each model, then call `warn` once.

    world_path  the world's file; table and sources lie beside it
    namespace   of the elements that our own writer puts into a world file
    """

    def __init__(self, world_path: str, namespace: str):
        self.path, self.namespace = world_path, namespace
        self.folder = os.path.dirname(os.path.abspath(world_path))
        self._table: Optional[Dict[str, Animation]] = None
        self._drawn: List[str] = []
        self._standing: List[str] = []

    def of(self, model: Element) -> Optional[Animation]:
        """How a model moves; None for one that stands still. Raises WorldError."""
        stated = model.find("{%s}waypoints" % self.namespace)
        if stated is not None:
            return self._stated(stated, "waypoints of model %r in %s" % (model.get("name"), self.path))
        for plugin in model.findall("plugin"):
            name = os.path.splitext(os.path.basename(plugin.get("filename") or ""))[0]
            found = self._in_table(name) or self._in_source(name)
            if found is not None:
                return found
            if _DYNABARNS.match(name):
                self._drawn.append(name)
                return drawn(name)
            self._standing.append(name or "(no filename)")
        return None

    def stands(self, model: Element) -> None:
        """Note that a model has an animation but no cylinder or sphere that could follow it."""
        self._standing += [plugin.get("filename", "") for plugin in model.findall("plugin")]

    def warn(self) -> None:
        """One warning that names all plugins without key frames, the first time that this world is read."""
        parts = []
        if self._drawn:
            parts.append(
                "no key frames of %s: these cylinders move on paths drawn from DynaBARN's recipe; make %s beside the "
                "world with python -m worlds.dynabarn_table for their own" % (_list(self._drawn), movers_table.NAME)
            )
        if self._standing:
            parts.append("not understood, so their models stand still: %s" % _list(self._standing))
        if parts and self.path not in _warned:
            _warned.add(self.path)
            log.warning("plugins of %s: %s", self.path, "; ".join(parts))

    def _stated(self, element: Element, what: str) -> Animation:
        """As sdf_writer puts it into a file: t x y t x y ..., with length and repeat where they are not the usual."""
        values = (element.text or "").split()
        flat = numbers(element.text, len(values) // 3 * 3, what)
        frames = [tuple(flat[i : i + 3]) for i in range(0, len(flat), 3)]
        length = element.get("length")
        end = frames[-1][0] if frames else 0.0
        return movers_table.checked(
            end if length is None else numbers(length, 1, "length of " + what)[0],
            element.get("repeat") != "0",
            frames,
            what,
        )

    def _in_table(self, name: str) -> Optional[Animation]:
        if self._table is None:
            path = os.path.join(self.folder, movers_table.NAME)
            self._table = movers_table.read(path) if os.path.lexists(path) else {}
        return self._table.get(name)

    def _in_source(self, name: str) -> Optional[Animation]:
        for folder in FOLDERS:
            for stem in {name, name[3:] if name.startswith("lib") else name}:
                source = os.path.join(self.folder, folder, stem + ".cc")
                if os.path.isfile(source):
                    return _from_source(source)
        return None


def _from_source(source: str) -> Animation:
    text = files.read_bytes(source, MAX_SOURCE, WorldError).decode("utf-8", "replace")
    what = "key frames in %s" % source
    frames: List[Tuple[float, ...]] = []
    time = ""
    for found in _CALL.findall(text):  # the first place after a time belongs to it
        if time and not found[0]:
            frames.append(tuple(numbers(cell, 1, what)[0] for cell in (time, *found[1:])))
            time = ""
        else:
            time = time or found[0]
    return movers_table.checked(frames[-1][0] if frames else 0.0, True, frames, what)


def _list(names: List[str]) -> str:
    unique = list(dict.fromkeys(names))
    return ", ".join(unique[:30]) + (" and %d more" % (len(unique) - 30) if len(unique) > 30 else "")


def drawn(name: str) -> Animation:
    """A random polynomial across the arena, the same for a plugin's name every time."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
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
    frames = tuple((float(t), float(a), float(b)) for t, (a, b) in zip(times, points))
    return Animation(frames[-1][0], True, frames)


def arena_course() -> Course:
    """DynaBARN's course: 20 m straight through the arena. Its reference path is the straight line."""
    path = np.column_stack([np.linspace(START[0], GOAL[0], 41), np.zeros(41)])
    return Course(start=START, goal=GOAL, finish_y=None, goal_tolerance=GOAL_TOLERANCE, path=path)
