"""Loader of worlds from a specification, such as "generated:7", a file or a folder.

All programs load worlds here, and scale the worlds to the robot that drives.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from collections.abc import Sequence
from typing import Any, Callable, List, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError

from . import barn, dynabarn, map_courses, physical_course, sdf_reader
from .world import Course, Mover, World

SPECIFICATIONS = (
    f"generated:N (0-{barn.COUNT - 1}), generated:train, generated:test, generated:validation, generated:learn, "
    "fresh:N, fresh:N-M (0 on), final:N, final:N-M (0-99), dynamic:N, dynamic:N-M, dynamic:validation, dynamic:test, "
    "physical_course, a .world file, a folder of them, or courses through a building: MAP.yaml, MAP.yaml:N, "
    "MAP.yaml:N-M, and those in either half of it, MAP.yaml:choose and MAP.yaml:report"
)
RADIUS_M = 0.31  # default radius of the robot's circle, the Jackal's [m]
MADE = ("fresh:", "final:", "dynamic:")  # prefixes of worlds that are generated on demand


class _Recipe(NamedTuple):
    """Recipe of numbered worlds.

    Attributes:
        make: Generator of a world with a number.
        split: Function that returns the numbers of a split by its name.
        end: End (exclusive) of the numbers that have no split of their own.
        has: Function that returns whether there is a world with a number; None if `end` decides.
    """

    make: Callable[[int], World]
    split: Callable[[str], Optional[Sequence[int]]]
    end: int
    has: Optional[Callable[[int], bool]] = None

    def numbers(self, part: str) -> Optional[Sequence[int]]:
        """Return the numbers of a split, of a number such as "7" or of a range such as "0-9"."""
        match = re.match(r"^(\d{1,9})(?:-(\d{1,9}))?$", part, re.ASCII)
        if match is None:
            return self.split(part)
        first = int(match.group(1))
        last = int(match.group(2) or first)
        exists = last < self.end if self.has is None else self.has(last)
        return range(first, last + 1) if exists else None


def _fresh(number: int) -> World:
    """Generate another world of BARN's recipe."""
    return dataclasses.replace(barn.generate(barn.COUNT + number), name=f"fresh:{number}")


def _final(number: int) -> World:
    """Generate a world reserved for published results, never for training or selection, of all kinds in turn."""
    return dataclasses.replace(barn.generate(3 * number, seed=20261125), name=f"final:{number}")


_RECIPES = {
    "generated": _Recipe(barn.world, barn.SPLITS.get, barn.COUNT),
    "fresh": _Recipe(_fresh, lambda _: None, 10**9),
    "final": _Recipe(_final, lambda _: None, 100),
    "dynamic": _Recipe(dynabarn.generate, dynabarn.SPLITS.get, 10**9),
}


@functools.lru_cache(maxsize=4)
def building(path: str, radius: float) -> map_courses.Building:
    """Return the building of a map for a robot within a circle of `radius` [m]."""
    return map_courses.Building(path, radius)


def _recipe(name: str, radius: float) -> Optional[_Recipe]:
    """Return the recipe of a name or of the path of a map; None if there is none."""
    if not name.endswith(".yaml"):
        return _RECIPES.get(name)
    courses = building(name, radius)
    return _Recipe(courses.course, courses.numbers, courses.count, courses.has)


def load(spec: str, radius: float = RADIUS_M) -> World:
    """Return the one world that `spec` names. Raise ApplrError if there is none or if it cannot be read.

    The courses of a map depend on the `radius` [m] of the circle around the robot.
    """
    text = str(spec)
    recipe = _recipe(text.partition(":")[0], radius)
    if recipe:
        names = specs(text, radius)
        if len(names) > 1:
            raise ApplrError(f"{text} names {len(names)} worlds, but one is needed; give one of them: {names[0]}")
        return recipe.make(int(names[0].partition(":")[2]))
    if text == physical_course.NAME:
        return physical_course.world()
    if text.endswith(".world"):
        return sdf_reader.read_world(text)
    if os.path.isdir(text):
        raise ApplrError(f"{text} is a folder, but one world is needed; give one of its .world files")
    raise ApplrError(f"unknown world {text!r}; give {SPECIFICATIONS}")


class Worlds(Sequence[World]):
    """Sequence of the worlds named by a specification, or by several separated by commas.

    Files and built-in worlds are loaded immediately, so that errors are reported at the beginning. Other worlds are
    generated on access, because each takes up to a tenth of a second. The latest 256 of them are cached.

    Raises:
        ApplrError: A specification or a file cannot be read.
    """

    def __init__(self, spec: str, radius: float = RADIUS_M) -> None:
        self.specs = [one for part in spec.split(",") for one in specs(part.strip(), radius)]
        self._loaded = {one: load(one, radius) for one in self.specs if not one.startswith(MADE)}
        self._made = functools.lru_cache(maxsize=256)(load)

    def __len__(self) -> int:
        return len(self.specs)

    def __getitem__(self, index: Any) -> Any:
        """Return world number `index`, or a list of worlds for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        name = self.specs[index]
        return self._loaded[name] if name in self._loaded else self._made(name)


def specs(spec: str, radius: float = RADIUS_M) -> List[str]:
    """Return the specifications of the single worlds that `spec` names, in the order of their numbers.

    Raises:
        ApplrError: There are no such numbers, or a folder contains no .world files.
    """
    text = str(spec)
    name, _, part = text.partition(":")
    recipe = _recipe(name, radius)
    if recipe:
        numbers = recipe.numbers(part)
        if numbers is not None and not numbers and part in map_courses.HALVES:
            raise ApplrError(
                f"{name}: none of its {recipe.end} courses stays in one half of the floor; "
                f"give {name}:0-{recipe.end - 1}, or a map with more floor"
            )
        if not numbers:
            raise ApplrError(f"no worlds {text!r} of {name}:0 to {name}:{recipe.end - 1}; give {SPECIFICATIONS}")
        return [f"{name}:{number}" for number in numbers]
    if not os.path.isdir(text):
        return [text]
    files = [os.path.join(text, file) for file in sorted(os.listdir(text), key=_by_number) if file.endswith(".world")]
    if not files:
        raise ApplrError(f"{text} contains no .world files; give a folder with .world files")
    return files


def _by_number(name: str) -> List[Tuple[int, int, str]]:
    """Return a sorting key, by which numbers in names are compared as numbers."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def scaled(world: World, factor: float) -> World:
    """Return a world of a recipe (generated:N, fresh:N, dynamic:N, physical_course) with lengths scaled by `factor`.

    The recipes have the Jackal's scale. Angles and times are unchanged. A room with moving obstacles is never enlarged,
    because its goal would lie outside the planners' maps. A world from a file is a real place and stays unchanged.
    """
    if world.movers:
        factor = min(factor, 1.0)
    recipe, colon, _ = world.name.partition(":")
    if factor == 1.0 or not (colon and recipe in _RECIPES or world.name == physical_course.NAME):
        return world
    course = world.course
    start, goal = ((x * factor, y * factor, yaw) for x, y, yaw in (course.start, course.goal))
    finish = None if course.finish_y is None else course.finish_y * factor
    way = Course(start, goal, finish, course.goal_tolerance * factor, course.path * factor, course.planner_ends)
    movers = tuple(
        Mover(m.radius * factor, tuple((t, x * factor, y * factor) for t, x, y in m.waypoints), m.length, m.repeat)
        for m in world.movers
    )
    boxes = world.boxes * np.array([factor, factor, 1.0, factor, factor])
    return World(world.name, world.cylinders * factor, boxes, way, movers)
