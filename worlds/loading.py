"""Loader of worlds from a specification, such as "generated:7", a file or a folder.

All programs load worlds here, and scale the worlds to the robot that drives.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from typing import Any, Callable, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import ApplrError

from . import barn, dynabarn, map_courses, sdf_reader
from .world import Course, Mover, World

SPECIFICATIONS = (
    f"generated:N (0-{barn.COUNT - 1}), generated:train, generated:test, generated:validation, "
    "generated:learn, fresh:N, fresh:N-M (0 on), final:N, final:N-M (0-99), dynamic:N, "
    "dynamic:N-M, dynamic:validation, dynamic:test, people:N, people:N-M, physical_course, "
    "a .world file, a folder of them, or courses through a building: MAP.yaml, MAP.yaml:N, "
    "MAP.yaml:N-M"
)
RADIUS_M = 0.31  # default radius of the robot's circle, the Jackal's [m]
FINAL_SEED = 20261125  # seed of the worlds final:N
PHYSICAL_COURSE = "physical_course"  # name of the paper's cardboard course, a file in data/
# Prefixes of worlds that are generated on demand
MADE = ("fresh:", "final:", "dynamic:", "people:")


@dataclasses.dataclass(frozen=True)
class _NumberedWorlds:
    """Recipe of numbered worlds. A Building has courses in the same way.

    Attributes:
        course: Generator of a world with a number.
        count: Number of the worlds.
        splits: Numbers by the names of splits.
    """

    course: Callable[[int], World]
    count: int
    splits: Mapping[str, Sequence[int]] = dataclasses.field(default_factory=dict)

    def has(self, number: int) -> bool:
        """Return whether there is a world with a number."""
        return number < self.count

    def numbers(self, split: str) -> Optional[Sequence[int]]:
        """Return the numbers of a split, or None if there is no such split."""
        return self.splits.get(split)


Recipe = Union[_NumberedWorlds, map_courses.Building]


def _selected(recipe: Recipe, selection: str) -> Optional[Sequence[int]]:
    """Return the numbers of a split, of a number such as "7" or of a range such as "0-9".

    Return None if there is no such split or number.
    """
    match = re.match(r"^(\d{1,9})(?:-(\d{1,9}))?$", selection, re.ASCII)
    if match is None:
        return recipe.numbers(selection)
    first_number = int(match.group(1))
    last_number = int(match.group(2) or first_number)
    # A range is refused as a whole: half of it would be evaluated as if it were complete.
    if not recipe.has(last_number):
        return None
    return range(first_number, last_number + 1)


def _fresh(number: int) -> World:
    """Generate another world of BARN's recipe."""
    return dataclasses.replace(barn.generate(barn.COUNT + number), name=f"fresh:{number}")


def _final(number: int) -> World:
    """Generate a world reserved for published results, never for training or selection."""
    # Every third number of the recipe: 100 numbers have worlds of all kinds.
    world = barn.generate(3 * number, seed=FINAL_SEED)
    return dataclasses.replace(world, name=f"final:{number}")


_RECIPES = {
    "generated": _NumberedWorlds(barn.world, barn.COUNT, barn.SPLITS),
    "fresh": _NumberedWorlds(_fresh, 10**9),
    "final": _NumberedWorlds(_final, 100),
    "dynamic": _NumberedWorlds(dynabarn.generate, 10**9, dynabarn.SPLITS),
    "people": _NumberedWorlds(dynabarn.people, 10**9),
}


@functools.lru_cache(maxsize=4)
def building(path: str, radius: float) -> map_courses.Building:
    """Return the building of a map for a robot within a circle of `radius` [m]."""
    return map_courses.Building(path, radius)


def _recipe(name: str, radius: float) -> Optional[Recipe]:
    """Return the recipe of a name or of the path of a map; None if there is none."""
    # The robot decides on the courses of a map, so that a map is a recipe for each radius.
    if name.endswith(".yaml"):
        return building(name, radius)
    return _RECIPES.get(name)


def load(spec: str, radius: float = RADIUS_M) -> World:
    """Return the one world that `spec` names.

    The courses of a map depend on the `radius` [m] of the circle around the robot.

    Raises:
        ApplrError: There is no such world, or it cannot be read.
    """
    spec_text = str(spec)
    recipe_name, _, _ = spec_text.partition(":")
    recipe = _recipe(recipe_name, radius)
    if recipe:
        world_specs = specs(spec_text, radius)
        if len(world_specs) > 1:
            raise ApplrError(
                f"{spec_text} names {len(world_specs)} worlds, but one is needed; "
                f"give one of them: {world_specs[0]}"
            )
        _, _, number = world_specs[0].partition(":")
        return recipe.course(int(number))
    if spec_text == PHYSICAL_COURSE:
        return sdf_reader.read_world(os.path.join(barn.FOLDER, "data", f"{PHYSICAL_COURSE}.world"))
    if spec_text.endswith(".world"):
        return sdf_reader.read_world(spec_text)
    if os.path.isdir(spec_text):
        raise ApplrError(
            f"{spec_text} is a folder, but one world is needed; give one of its .world files"
        )
    raise ApplrError(f"unknown world {spec_text!r}; give {SPECIFICATIONS}")


class Worlds(Sequence[World]):
    """Sequence of the worlds named by a specification, or by several separated by commas.

    Files and built-in worlds are loaded immediately, so that errors are reported at the beginning.
    Other worlds are generated on access, because each takes up to a tenth of a second. The latest
    256 of them are cached.

    Raises:
        ApplrError: A specification or a file cannot be read.
    """

    def __init__(self, spec: str, radius: float = RADIUS_M) -> None:
        self.specs = listed_specs(spec, radius)
        loaded_specs = [spec for spec in self.specs if not spec.startswith(MADE)]
        world_of = functools.partial(load, radius=radius)
        self._world_of = functools.lru_cache(256 + len(loaded_specs))(world_of)
        for loaded_spec in loaded_specs:
            self._world_of(loaded_spec)

    def __len__(self) -> int:
        return len(self.specs)

    def __getitem__(self, index: Any) -> Any:
        """Return world number `index`, or a list of worlds for a slice."""
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        return self._world_of(self.specs[index])


def listed_specs(text: str, radius: float = RADIUS_M) -> List[str]:
    """Return the specifications of the single worlds of a list separated by commas.

    Raises:
        ApplrError: As specs().
    """
    listed = []
    for listed_spec in text.split(","):
        listed += specs(listed_spec.strip(), radius)
    return listed


def specs(spec: str, radius: float = RADIUS_M) -> List[str]:
    """Return the specifications of the single worlds that `spec` names, ordered by number.

    Raises:
        ApplrError: There are no such numbers, or a folder contains no .world files.
    """
    spec_text = str(spec)
    recipe_name, _, selection = spec_text.partition(":")
    recipe = _recipe(recipe_name, radius)
    if recipe:
        numbers = _selected(recipe, selection)
        if numbers == [] and selection in map_courses.HALVES:
            raise ApplrError(
                f"{recipe_name}: none of its {recipe.count} courses stays in one half of the "
                f"floor; give {recipe_name}:0-{recipe.count - 1}, or a map with more floor"
            )
        if not numbers:
            last_world = f"{recipe_name}:{recipe.count - 1}"
            known_worlds = f"{recipe_name}:0 to {last_world}"
            raise ApplrError(f"no worlds {spec_text!r} of {known_worlds}; give {SPECIFICATIONS}")
        return [f"{recipe_name}:{number}" for number in numbers]
    if not os.path.isdir(spec_text):
        return [spec_text]
    file_names = sorted(os.listdir(spec_text), key=_by_number)
    world_file_names = [file_name for file_name in file_names if file_name.endswith(".world")]
    world_files = [os.path.join(spec_text, file_name) for file_name in world_file_names]
    if not world_files:
        raise ApplrError(f"{spec_text} contains no .world files; give a folder with .world files")
    return world_files


def _by_number(name: str) -> List[Tuple[int, int, str]]:
    """Return a sorting key, by which numbers in names are compared as numbers."""
    sorting_key = []
    for name_part in re.split(r"(\d+)", name):
        # The first element keeps numbers from being compared with texts.
        if name_part.isdigit():
            sorting_key.append((0, int(name_part), ""))
        else:
            sorting_key.append((1, 0, name_part))
    return sorting_key


def scaled(world: World, factor: float) -> World:
    """Return a world of a recipe with lengths scaled by `factor`.

    The recipes (generated:N, fresh:N, dynamic:N, people:N, physical_course) have the Jackal's
    scale. Angles and times are unchanged. A room with moving obstacles is never enlarged, because
    its goal would lie outside the planners' maps. A world from a file is a real place and stays
    unchanged.
    """
    if world.movers:
        factor = min(factor, 1.0)
    recipe_name, colon, _ = world.name.partition(":")
    # The colon distinguishes generated:7 from a file with the name generated.world.
    is_from_recipe = colon and recipe_name in _RECIPES or world.name == PHYSICAL_COURSE
    if factor == 1.0 or not is_from_recipe:
        return world
    return dataclasses.replace(
        world,
        cylinders=world.cylinders * factor,
        boxes=world.boxes * np.array([factor, factor, 1.0, factor, factor]),
        course=_scaled_course(world.course, factor),
        movers=tuple(_scaled_mover(mover, factor) for mover in world.movers),
    )


def _scaled_course(course: Course, factor: float) -> Course:
    """Return a course with all lengths multiplied by a factor."""
    finish_y = course.finish_y
    if finish_y is not None:
        finish_y *= factor
    return dataclasses.replace(
        course,
        start=_scaled_pose(course.start, factor),
        goal=_scaled_pose(course.goal, factor),
        finish_y=finish_y,
        goal_tolerance=course.goal_tolerance * factor,
        path=course.path * factor,
    )


def _scaled_pose(pose: Pose, factor: float) -> Pose:
    x, y, yaw = pose
    return x * factor, y * factor, yaw


def _scaled_mover(mover: Mover, factor: float) -> Mover:
    waypoints = tuple((t, x * factor, y * factor) for t, x, y in mover.waypoints)
    return dataclasses.replace(mover, radius=mover.radius * factor, waypoints=waypoints)
