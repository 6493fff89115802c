"""The moving cylinders of DynaBARN's worlds.

Their paths are compiled into Gazebo plugins, which the world file only names. This finds the key frames in the table
movers.csv beside the world. `sdf_reader` calls it.
"""

from __future__ import annotations

import math
import os
from typing import Dict, Optional
from xml.etree.ElementTree import Element

import numpy as np

from . import movers_table
from .movers_table import Animation
from .sdf_xml import numbers
from .world import Course, WorldError

START, GOAL = (11.0, 0.0, math.pi), (-9.0, 0.0, math.pi)  # the BARN Challenge's: 20 m, heading -x
GOAL_TOLERANCE = 1.0  # also the Challenge's


class Animations:
    """The animations of one world's models.

    world_path  the world's file; the table lies beside it
    namespace   of the elements that our own writer puts into a world file
    """

    def __init__(self, world_path: str, namespace: str):
        self.path, self.namespace = world_path, namespace
        self._table: Optional[Dict[str, Animation]] = None

    def of(self, model: Element) -> Optional[Animation]:
        """How a model moves; None for one without a plugin. Raises WorldError where the table lacks its plugin."""
        stated = model.find(f"{{{self.namespace}}}waypoints")
        if stated is not None:
            return self._stated(stated, f"waypoints of model {model.get('name')!r} in {self.path}")
        plugin = model.find("plugin")
        if plugin is None:
            return None
        name = os.path.splitext(os.path.basename(plugin.get("filename") or ""))[0]
        if self._table is None:
            table = os.path.join(os.path.dirname(os.path.abspath(self.path)), movers_table.NAME)
            self._table = movers_table.read(table) if os.path.lexists(table) else {}
        if name not in self._table:
            raise WorldError(
                f"plugin {name!r} of model {model.get('name')!r} in {self.path} has no rows in {movers_table.NAME} "
                "beside the world; make that table with python -m worlds.dynabarn_table WORLDS_DIR PLUGINS_DIR"
            )
        return self._table[name]

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


def arena_course() -> Course:
    """DynaBARN's course: 20 m straight through the arena. Its reference path is the straight line."""
    path = np.column_stack([np.linspace(START[0], GOAL[0], 41), np.zeros(41)])
    return Course(start=START, goal=GOAL, finish_y=None, goal_tolerance=GOAL_TOLERANCE, path=path)
