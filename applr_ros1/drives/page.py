"""Self-contained web page that animates drives, world by world, those of all methods in one map.

The page of an evaluation's report shows all drives whose paths were recorded, and the page of the
demo its single drive. The scripts scene.js and page.js draw the drives. Lengths, times and speeds
are integers, to keep the file small.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.pages.colors import color_indices
from applr_ros1.common.pages.page import Page
from applr_ros1.drives.contact import contact_in_words, contact_speed
from applr_ros1.drives.drive import REACHED, Drive, Driven, DrivenToGoal
from applr_ros1.monitor.stopping import edge_points
from applr_ros1.policy.parameter_space import Space
from worlds.world import World, clearance

HERE = Path(__file__).parent
SCENE = HERE / "scene.js"  # script that draws what scene_values returns
SCRIPTS = (SCENE, HERE / "page.js")
POSE_PERIOD_S = 0.2  # interval between two poses of a drive [s]
MARGIN_M = 1.2  # margin of the view before and behind the driven path [m]
# Distance beside the driven path up to which obstacles are shown [m]; BARN's fields are 4.5 m wide
ASIDE_M = 3.5
SIDE_M = 0.3  # margin of the view beside the outermost obstacles [m]
DIGITS = 4  # significant digits of a parameter


class Shown(NamedTuple):
    """Drive on a page.

    Attributes:
        method: Index of the drive's method in the page's list.
        trial: Number of the trial; drives with the same number are shown side by side.
        drive: The drive, with true motion, decisions, contacts and one goal.
    """

    method: int
    trial: int
    drive: Drive


@dataclass
class PageScene:
    """A world with its drives, which start at the world's time `begins` [s]."""

    name: str
    world: World
    drives: Sequence[Shown]
    begins: float = 0.0


def page(
    title: str,
    verdict: str,
    methods: Sequence[str],
    space: Space,
    outline: Array,
    scenes: Sequence[PageScene],
    marked: bool = False,
    back: str = "",
    units: Mapping[str, str] = {},
    measured: Sequence[str] = (),
) -> bytes:
    """Return the HTML of the page, encoded in UTF-8.

    Args:
        title: Title of the page.
        verdict: How the drives went, in a sentence.
        methods: Names of the methods in the order of Shown.method.
        space: Space of the parameters.
        outline: Corners (n, 2) of the robot's outline [m].
        scenes: One or more worlds with their drives.
        marked: Whether the planner used predicted obstacle points.
        back: HTML of a link above the drives.
        units: {name: unit} of the parameters.
        measured: Sentences that say how it was measured.
    """
    colors = color_indices(methods)
    values = {
        "methods": [{"name": method_name, "color": colors[method_name]} for method_name in methods],
        "parameters": parameter_values(space, units),
        "outline": np.round(outline, 3).tolist(),
        "worlds": [scene_values(scene, marked) for scene in scenes],
    }
    is_single = len(scenes) == 1 and len(scenes[0].drives) == 1
    page_kind = "drive" if is_single else "drives"
    return Page(page_kind, title, verdict, SCRIPTS, values, back, measured).html()


def verdict_of(drive: Drive, world: World, outline: Array, begins: float = 0.0) -> str:
    """Return in a sentence how a drive ended, its length, and the distance of the nearest obstacle.

    Args:
        drive: Drive with true motion and a goal.
        world: World in which the robot drove.
        outline: Corners (n, 2) of the robot's outline [m].
        begins: Time of the world at which the drive begins [s].
    """
    truth, goals = drive.require(DrivenToGoal)
    goal = goals[-1]
    duration = f"{goal.end - goal.begin:.1f} s"
    if goal.status == REACHED:
        ending = f"Reached the goal in {duration}"
    else:
        ending = f"Did not reach the goal: {goal.reason} after {duration}"
    nearest_distance = nearest_obstacle(drive, world, outline, begins)
    distances = f"{truth.length:.1f} m, nearest obstacle {nearest_distance:.2f} m"
    return f"{ending}, {distances}{contact_note(drive)}"


def contact_note(drive: Drive) -> str:
    """Return the first contact of a drive, to be appended to a sentence; "" without one."""
    if not len(drive.contacts):
        return ""
    return f", {contact_in_words(contact_speed(drive))}"


def nearest_obstacle(drive: Drive, world: World, outline: Array, begins: float) -> float:
    """Return the smallest distance [m] between the robot's outline and an obstacle, at least 0."""
    poses, _ = sampled(drive)
    edges = edge_points(outline)
    nearest_distance = np.inf
    for index, (x, y, yaw) in enumerate(poses.tolist()):
        outline_points = np.column_stack(transform_point((x, y, yaw), *edges.T))
        world_time = begins + POSE_PERIOD_S * index
        distances = clearance(world, outline_points, world.mover_circles(world_time))
        nearest_distance = min(nearest_distance, float(distances.min()))
    return max(nearest_distance, 0.0)


def parameter_values(space: Space, units: Mapping[str, str] = {}) -> List[Dict[str, Any]]:
    """Return names, ranges, default values and units of parameters as JSON values.

    Args:
        space: Space of the parameters.
        units: {name: unit} of the parameters, as far as they are known.
    """
    parameters = []
    for i, parameter_name in enumerate(space.names):
        parameter = {
            "name": parameter_name,
            "unit": units.get(parameter_name, ""),
            "low": float(space.low[i]),
            "high": float(space.high[i]),
            "default": float(space.theta0[i]),
        }
        parameters.append(parameter)
    return parameters


def scene_values(scene: PageScene, marked: bool = False) -> Dict[str, Any]:
    """Return a scene as SCENE reads it. Lengths are in cm, those of circles in mm.

    Args:
        scene: World with its drives.
        marked: Whether the planner used predicted obstacle points.
    """
    world = scene.world
    course = world.course
    drives = []
    driven_paths = [np.array([course.start[:2]])]
    for shown in scene.drives:
        drives.append(_drive(shown))
        poses, _ = sampled(shown.drive)
        driven_paths.append(poses[:, :2])

    # Only obstacles near a driven path are shown: a world may be much larger.
    driven_points = np.concatenate(driven_paths)
    lowest = driven_points.min(axis=0)
    highest = driven_points.max(axis=0)
    circles = _near(world.cylinders, world.cylinders[:, 2], lowest, highest)
    size_x, size_y = world.boxes[:, 3:].T
    box_radii = np.hypot(size_x, size_y) / 2.0
    boxes = _near(world.boxes, box_radii, lowest, highest)

    # In x the view holds all obstacles that are shown. In y it has room for those beside a drive
    # along x, and a margin before and behind a drive along y.
    shown_x = np.concatenate([driven_points[:, 0], circles[:, 0], boxes[:, 0]])
    extent_x, extent_y = highest - lowest
    margin = ASIDE_M if extent_x > extent_y else MARGIN_M
    view = [shown_x.min() - SIDE_M, lowest[1] - margin, shown_x.max() + SIDE_M, highest[1] + margin]

    pose_count = max(len(drive["p"]) for drive in drives)
    pose_times = (scene.begins + POSE_PERIOD_S * np.arange(pose_count)).tolist()
    movers = []
    for mover in world.movers:
        mover_positions = list(map(mover.position, pose_times))
        movers.append([round(100 * mover.radius), _whole(mover_positions, 100)])
    return {
        "name": scene.name,
        "period": POSE_PERIOD_S,
        "marked": marked,
        "view": _whole(view, 100),
        "circles": _whole(circles, 1000),
        "boxes": _whole(boxes, 100),
        "movers": movers,
        "start": _whole(course.start, 100),
        "goal": _whole([*course.goal[:2], course.goal_tolerance], 100),
        "finish": None if course.finish_y is None else round(100 * course.finish_y),
        "drives": drives,
    }


def _drive(shown: Shown) -> Dict[str, Any]:
    """Return a drive as the page's script reads it."""
    drive = shown.drive
    goal = drive.goals[-1]
    poses, speeds = sampled(drive)
    values = {
        "m": shown.method,
        "k": shown.trial,
        "t": round(goal.end - goal.begin, 1),
        "ok": goal.status == REACHED,
        "hit": contact_note(drive),
        "why": goal.reason,
        # Differences have fewer digits than poses.
        "p": np.diff(np.rint(poses * 100.0).astype(int), axis=0, prepend=0).tolist(),
        "v": _whole(speeds, 100),
    }
    # When a goal has ended, the defaults are set again. The observation there has no parameters.
    end_time = drive.require(Driven).truth.time[-1]
    decision_times = []
    parameter_sets = []
    for decision in drive.decisions:
        if decision.after and decision.time <= end_time:
            decision_times.append(decision.time)
            parameter_sets.append(_short(decision.after))
    if decision_times:
        values["at"] = _whole(decision_times, 100)
        values["theta"] = parameter_sets
    return values


def _short(parameters: Mapping[str, float]) -> List[float]:
    """Return the values of parameters with DIGITS significant digits."""
    return [float(f"{value:.{DIGITS}g}") for value in parameters.values()]


def sampled(drive: Drive) -> Tuple[Array, Array]:
    """Return poses (n, 3) and speeds (n,) of a drive, one per POSE_PERIOD_S and the last one."""
    motion = drive.require(Driven).truth
    begin_time = motion.time[0]
    end_time = motion.time[-1]
    regular_times = np.arange(begin_time, end_time, POSE_PERIOD_S)
    times = np.unique(np.append(regular_times, end_time))
    speeds = np.interp(times, motion.time, motion.twist[:, 0])
    return motion.poses_at(times), speeds


def _near(obstacles: Array, radius: Array, lowest: Array, highest: Array) -> Array:
    """Return the obstacles within ASIDE_M of the box from `lowest` to `highest`.

    Args:
        obstacles: (n, ...) x, y [m] and further columns.
        radius: (n,) radius of each obstacle [m].
        lowest: (2,) least x, y [m].
        highest: (2,) largest x, y [m].
    """
    reach = ASIDE_M + radius[:, None]
    positions = obstacles[:, :2]
    is_near = (positions > lowest - reach) & (positions < highest + reach)
    return obstacles[is_near.all(axis=1)]


def _whole(values: Any, scale: float) -> Any:
    """Return values times `scale`, rounded to integers."""
    return np.rint(np.asarray(values, dtype=np.float64) * scale).astype(int).tolist()
