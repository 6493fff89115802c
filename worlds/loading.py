"""From a specification that a person types ("generated:7", a file, a folder) to worlds.

Everything loads through here, and is brought to the scale of the robot that drives.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from collections.abc import Sequence
from typing import Any, Callable, Dict, List, NamedTuple

import numpy as np

from . import barn, dynabarn, physical_course, sdf_reader
from .world import Mover, World, WorldError

SPECIFICATIONS = (
    f"generated:N (0-{barn.COUNT - 1}), generated:train, generated:test, generated:validation, generated:learn, "
    "fresh:N, fresh:N-M (0 on), final:N, final:N-M (0-99), dynamic:N, dynamic:N-M, dynamic:validation, dynamic:test, "
    "physical_course, a .world file, a folder of them, or FOLDER:choose and FOLDER:report for the halves of BARN's "
    "training worlds in it"
)
HALVES = {"choose": 0, "report": 1}  # of BARN's training worlds: even numbers are for choices, odd ones for figures
MADE = ("fresh:", "final:", "dynamic:")  # on the spot, from a seed


class _Recipe(NamedTuple):
    """Worlds with a number: how one is made, numbers by a name, and the first number that there is not."""

    make: Callable[[int], World]
    splits: Dict[str, Any]
    end: int


def _fresh(number: int) -> World:
    """More worlds of the generator's recipe, made on the spot."""
    return dataclasses.replace(barn.generate(barn.COUNT + number), name=f"fresh:{number}")


def _final(number: int) -> World:
    """Worlds of the recipe for published figures alone: nothing is trained or chosen in them. All its kinds in turn."""
    return dataclasses.replace(barn.generate(3 * number, seed=20261125), name=f"final:{number}")


_RECIPES = {
    "generated": _Recipe(barn.world, barn.SPLITS, barn.COUNT),
    "fresh": _Recipe(_fresh, {}, 10**9),
    "final": _Recipe(_final, {}, 100),
    "dynamic": _Recipe(dynabarn.generate, dynabarn.SPLITS, 10**9),
}


def load(spec: str) -> World:
    """The one world that `spec` names. Raises WorldError with one line."""
    text = str(spec)
    recipe, _, _ = text.partition(":")
    if recipe in _RECIPES:
        names = specs(text)
        if len(names) > 1:
            raise WorldError(f"{text} names {len(names)} worlds where one is needed; give one of them")
        return _RECIPES[recipe].make(int(names[0].partition(":")[2]))
    if text == physical_course.NAME:
        return physical_course.world()
    if text.endswith(".world"):
        return sdf_reader.read_world(text)
    if os.path.isdir(text):
        raise WorldError(f"{text} is a folder where one world is needed; give one of its .world files")
    raise WorldError(f"unknown world {text!r}; give {SPECIFICATIONS}")


class Worlds(Sequence):
    """The worlds of a specification, several with commas between them, as a sequence.

    Files and built-in worlds are loaded at once, so that a wrong one is reported at the beginning. Others are
    generated when they are asked for, since each takes up to a tenth of a second; the last KEPT of them stay.

    Raises:
        WorldError: for a specification or a file that cannot be read.
    """

    KEPT = 256

    def __init__(self, spec: str):
        self.specs = [one for part in spec.split(",") for one in specs(part.strip())]
        self._loaded = {one: load(one) for one in self.specs if not one.startswith(MADE)}
        self._made = functools.lru_cache(maxsize=self.KEPT)(load)

    def __len__(self) -> int:
        return len(self.specs)

    def __getitem__(self, index):
        """World number `index`, or a list of them for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        name = self.specs[index]
        return self._loaded[name] if name in self._loaded else self._made(name)


def specs(spec: str) -> List[str]:
    """Return the specifications of the single worlds that `spec` names, by their numbers."""
    text = str(spec)
    name, _, part = text.partition(":")
    recipe = _RECIPES.get(name)
    if recipe is None:
        folder, _, half = text.rpartition(":")
        if half in HALVES and os.path.isdir(folder):
            return barn_half(folder, half)
        return folder_files(text) if os.path.isdir(text) else [text]
    numbers = recipe.splits.get(part)
    if numbers is None:
        match = re.match(r"^(\d{1,9})(?:-(\d{1,9}))?$", part, re.ASCII)
        first, last = (int(match.group(1)), int(match.group(2) or match.group(1))) if match else (0, -1)
        if not first <= last < recipe.end:
            raise WorldError(f"no worlds {text!r}; give {SPECIFICATIONS}")
        numbers = range(first, last + 1)
    return [f"{name}:{number}" for number in numbers]


def folder_files(folder: str) -> List[str]:
    """The .world files directly in a folder, by number, then name. WorldError where there is none."""
    names = [n for n in os.listdir(folder) if n.endswith(".world")]
    if not names:
        raise WorldError(f"{folder} holds no .world files; give a folder with some")
    return [os.path.join(folder, name) for name in sorted(names, key=_natural)]


def barn_half(folder: str, half: str) -> List[str]:
    """The files world_N.world of a folder whose N is one of BARN's training numbers in a half, one of HALVES.

    WorldError where there is none.
    """
    numbers = [n for n in barn.TRAIN if n % 2 == HALVES[half]]
    files = [os.path.join(folder, "world_%d.world" % n) for n in numbers]
    found = [file for file in files if os.path.isfile(file)]
    if not found:
        raise WorldError(f"{folder}:{half}: the folder holds no world_{numbers[0]}.world or the like")
    return found


def _natural(name: str):
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def scaled(world: World, factor: float) -> World:
    """A world of a recipe (generated:N, fresh:N, dynamic:N, physical_course) with all lengths multiplied by `factor`.

    The recipes fit the Jackal. Angles and times stay. A room of moving obstacles grows no larger: its goal would lie
    off the planners' maps. A world from a file, which is a place, or a factor of 1 gives the world itself.
    """
    if world.movers:
        factor = min(factor, 1.0)
    recipe, colon, _ = world.name.partition(":")
    if factor == 1.0 or not (colon and recipe in _RECIPES or world.name == physical_course.NAME):
        return world
    course = world.course
    return dataclasses.replace(
        world,
        cylinders=world.cylinders * factor,
        boxes=world.boxes * np.array([factor, factor, 1.0, factor, factor]),
        course=dataclasses.replace(
            course,
            start=(course.start[0] * factor, course.start[1] * factor, course.start[2]),
            goal=(course.goal[0] * factor, course.goal[1] * factor, course.goal[2]),
            finish_y=None if course.finish_y is None else course.finish_y * factor,
            goal_tolerance=course.goal_tolerance * factor,
            path=course.path * factor,
        ),
        movers=tuple(
            Mover(m.radius * factor, tuple((t, x * factor, y * factor) for t, x, y in m.waypoints), m.length, m.repeat)
            for m in world.movers
        ),
    )
