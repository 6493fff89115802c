"""Moving cylinders of DynaBARN worlds.

DynaBARN compiles the paths of its cylinders into Gazebo plugins, and a world file only names the
plugins. `sdf_reader` takes the key frames from the table movers.csv beside the world, with one row
per key frame and the columns plugin, length, repeat, time, x, y. docs/reference/worlds.md describes
how to make the table. `generate` returns further worlds: a room of 20 x 20 m with moving cylinders,
alternately of DynaBARN's slow, medium and fast kinds. `people` returns such rooms with people, of
whom most look where they walk.
"""

from __future__ import annotations

import csv
import functools
import io
import math
import os
from typing import Callable, Dict, List, Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.common.files import read_bytes, reading

from .sdf import NAMESPACE, numbers
from .world import Course, KeyFrame, Mover, World

# start and goal of the BARN Challenge, 20 m along -x
START = (11.0, 0.0, math.pi)
GOAL = (-9.0, 0.0, math.pi)
GOAL_TOLERANCE_M = 1.0  # goal tolerance of the BARN Challenge [m]

NAME = "movers.csv"
COLUMNS = ("plugin", "length", "repeat", "time", "x", "y")
Animation = Callable[[float], Mover]  # returns the moving cylinder for a radius [m]


@functools.lru_cache(maxsize=4)
def read_table(path: str) -> Dict[str, Animation]:
    """Return the animations of a table by plugin."""
    animations: Dict[str, Animation] = {}
    frames_by_plugin: Dict[str, List[KeyFrame]] = {}
    with reading(path):
        # Spreadsheets write a byte order mark, which utf-8-sig skips.
        table_text = read_bytes(path).decode("utf-8-sig")
        for table_row in csv.DictReader(io.StringIO(table_text, newline="")):
            plugin = table_row["plugin"]
            values = " ".join(table_row[name] for name in ("length", "time", "x", "y"))
            length, frame_time, x, y = numbers(values, 4, f"a row of {plugin}")
            waypoints = frames_by_plugin.setdefault(plugin, [])
            waypoints.append((frame_time, x, y))
            # The last row of a plugin has all its key frames.
            animations[plugin] = functools.partial(
                Mover,
                waypoints=tuple(waypoints),
                length=length,
                repeat=table_row["repeat"] == "1",
            )
    return animations


def animation_of(model: Element, path: str) -> Optional[Animation]:
    """Return the animation of a model in the world file `path`, or None if the model has no plugin.

    Raises:
        ApplrError: The table beside the file has no rows of the plugin.
    """
    title = f"model {shown(model.get('name'))}"
    stored_frames = model.find(f"{{{NAMESPACE}}}waypoints")
    if stored_frames is not None:
        frame_numbers = numbers(stored_frames.text, 3, f"waypoints of {title}", rows=True)
        times = frame_numbers[::3]
        x = frame_numbers[1::3]
        y = frame_numbers[2::3]
        return functools.partial(
            Mover,
            waypoints=tuple(zip(times, x, y)),
            length=float(stored_frames.get("length", 0.0)),
            repeat=stored_frames.get("repeat") != "0",
            looks=stored_frames.get("looks") == "1",
        )

    plugin = model.find("plugin")
    if plugin is None:
        return None
    plugin_file = plugin.get("filename") or ""
    plugin_name, _ = os.path.splitext(os.path.basename(plugin_file))
    if plugin_name.startswith("libgazebo_ros_"):
        return None  # These plugins move a model only on command.
    table_path = os.path.join(os.path.dirname(os.path.abspath(path)), NAME)
    animations = {}
    if os.path.lexists(table_path):
        animations = read_table(table_path)
    if plugin_name not in animations:
        raise ApplrError(
            f"{title} has the Gazebo plugin {shown(plugin_file)}, which has no rows in {NAME} "
            "beside the world: if the plugin moves nothing, remove it from a copy of the world; "
            "otherwise make that table once, as docs/reference/worlds.md describes"
        )
    return animations[plugin_name]


def arena_course(planner_ends: bool = False) -> Course:
    """Return DynaBARN's course: 20 m straight through the arena, with a goal tolerance of 1 m."""
    x = np.linspace(START[0], GOAL[0], 41)
    path = np.column_stack([x, np.zeros(len(x))])
    return Course(
        start=START,
        goal=GOAL,
        finish_y=None,
        goal_tolerance=GOAL_TOLERANCE_M,
        path=path,
        planner_ends=planner_ends,
    )


# numbers by split; 100 and up are free for training
SPLITS = {"test": range(50), "validation": range(50, 100)}
# by kind of world (slow, medium, fast, people): range of the speed [m/s], and of the number of
# obstacles
SPEEDS_M_S = ((0.3, 0.95), (0.8, 1.5), (1.4, 1.95), (0.5, 1.5))
MOVER_COUNTS = ((6, 12), (8, 18), (10, 24), (8, 18))
PEOPLE = 3  # index of the kind with people
ON_THE_PHONE = 3  # One person of so many looks at a telephone, and does not see the robot.
RADII_M = (0.25, 0.5)  # radius range, from a person to DynaBARN's cylinders [m]
HALF_SIDE_M = 10.0  # half the side length of the room [m]
WALL_WIDTH_M = 0.5  # thickness of the room's walls [m]
DETOUR_M = 2.0  # standard deviation of a path's points from the straight line [m]
SHORTEST_LEG_M = 0.05  # smallest length of a leg for its duration, which must not be 0 [m]
# boxes x, y, yaw, size_x, size_y [m, rad]; the side of the start is open
WALLS = np.array(
    [
        [-HALF_SIDE_M, 0, 0, WALL_WIDTH_M, 2 * HALF_SIDE_M],
        [0, HALF_SIDE_M, 0, 2 * HALF_SIDE_M, WALL_WIDTH_M],
        [0, -HALF_SIDE_M, 0, 2 * HALF_SIDE_M, WALL_WIDTH_M],
    ]
)
SEED = 20220601
PEOPLE_SEED = 20261130


def generate(number: int) -> World:
    """Return world `number` >= 0."""
    return _room("dynamic", SEED, number, number % PEOPLE)


def people(number: int) -> World:
    """Return room `number` >= 0 with people."""
    return _room("people", PEOPLE_SEED, number, PEOPLE)


def _room(recipe: str, seed: int, number: int, kind: int) -> World:
    rng = np.random.default_rng([seed, number])
    fewest_movers, most_movers = MOVER_COUNTS[kind]
    mover_count = int(rng.integers(fewest_movers, most_movers + 1))
    movers = []
    for index in range(mover_count):
        looks = kind == PEOPLE and index % ON_THE_PHONE > 0
        movers.append(_mover(rng, SPEEDS_M_S[kind], looks))
    return World(
        name=f"{recipe}:{number}",
        cylinders=np.empty((0, 3)),
        boxes=WALLS,
        course=arena_course(planner_ends=True),
        movers=tuple(movers),
    )


def _mover(rng: np.random.Generator, speeds: Tuple[float, float], looks: bool) -> Mover:
    """Draw a cylinder that crosses the room from wall to wall, with a new speed on each leg."""
    # The order of the draws is part of the recipe: another order would make other worlds.
    first_wall, last_wall = rng.choice(4, 2, replace=False)
    start_point = _at_a_wall(rng, first_wall)
    end_point = _at_a_wall(rng, last_wall)
    detour_count = int(rng.integers(1, 6))
    detour_shares = np.sort(rng.uniform(0.1, 0.9, detour_count))
    path_points = [start_point]
    for detour_share in detour_shares:
        detour = rng.normal(0.0, DETOUR_M, 2)
        path_points.append(start_point + detour_share * (end_point - start_point) + detour)
    path_points.append(end_point)
    corners = np.clip(path_points, -HALF_SIDE_M, HALF_SIDE_M)

    arrival_time = 0.0
    x, y = corners[0].tolist()
    key_frames = [(arrival_time, x, y)]
    legs = np.diff(corners, axis=0)
    for corner, leg in zip(corners[1:], legs):
        leg_length = max(math.hypot(*leg), SHORTEST_LEG_M)
        speed = rng.uniform(*speeds)
        arrival_time += leg_length / speed
        x, y = corner.tolist()
        key_frames.append((arrival_time, x, y))
    radius = float(rng.uniform(*RADII_M))
    return Mover(radius, tuple(key_frames), looks=looks)


def _at_a_wall(rng: np.random.Generator, wall: int) -> Array:
    """Draw a point (2,) [m] on one of the four sides of the room.

    Sides 0 and 1 are those with the lowest and the highest x, sides 2 and 3 those of y.
    """
    along_wall = rng.uniform(-0.9 * HALF_SIDE_M, 0.9 * HALF_SIDE_M)
    across_wall = -HALF_SIDE_M
    if wall in (1, 3):
        across_wall = HALF_SIDE_M
    if wall < 2:
        return np.array([across_wall, along_wall])
    return np.array([along_wall, across_wall])
