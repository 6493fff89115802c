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
from applr_ros1.common.pages.colors import color_indices
from applr_ros1.common.pages.page import Page
from applr_ros1.drives.drive import REACHED, Drive
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
# Distance of the points of a robot's outline that are compared with obstacles [m]
OUTLINE_M = 0.05
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
class Scene:
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
    body: Sequence[float],
    scenes: Sequence[Scene],
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
        body: Length and width of the robot [m].
        scenes: One or more worlds with their drives.
        marked: Whether the planner used predicted obstacle points.
        back: HTML of a link above the drives.
        units: {name: unit} of the parameters.
        measured: Sentences that say how it was measured.
    """
    colors = color_indices(methods)
    values = {
        "methods": [{"name": name, "color": colors[name]} for name in methods],
        "parameters": parameter_values(space, units),
        "body": list(body),
        "worlds": [scene_values(scene, marked) for scene in scenes],
    }
    is_single = len(scenes) == 1 and len(scenes[0].drives) == 1
    kind = "drive" if is_single else "drives"
    return Page(kind, title, verdict, SCRIPTS, values, back, measured).html()


def verdict_of(drive: Drive, world: World, body: Sequence[float], begins: float = 0.0) -> str:
    """Return in a sentence how a drive ended, its length, and the distance of the nearest obstacle.

    Args:
        drive: Drive with true motion and a goal.
        world: World in which the robot drove.
        body: Length and width of the robot [m].
        begins: Time of the world at which the drive begins [s].
    """
    drive.require("truth", "goals")
    assert drive.truth is not None
    goal = drive.goals[-1]
    seconds = f"{goal.end - goal.begin:.1f} s"
    if goal.status == REACHED:
        end = f"Reached the goal in {seconds}"
    else:
        end = f"Did not reach the goal: {goal.reason} after {seconds}"
    nearest = nearest_obstacle(drive, world, body, begins)
    contact = ", touched something" if len(drive.contacts) else ""
    return f"{end}, {drive.truth.length:.1f} m, nearest obstacle {nearest:.2f} m{contact}"


def nearest_obstacle(drive: Drive, world: World, body: Sequence[float], begins: float) -> float:
    """Return the smallest distance [m] between the robot's outline and an obstacle, at least 0."""
    poses, _ = sampled(drive)
    outline = _outline(body)
    nearest = np.inf
    for row, (x, y, yaw) in enumerate(poses.tolist()):
        points = np.column_stack(transform_point((x, y, yaw), *outline.T))
        gaps = clearance(world, points, begins + POSE_PERIOD_S * row)
        nearest = min(nearest, float(gaps.min()))
    return max(nearest, 0.0)


def _outline(body: Sequence[float]) -> np.ndarray:
    """Return points (n, 2) along the edges of a rectangle (length, width) [m] around the origin."""
    length, width = body
    along = _centred(length)
    across = _centred(width)
    edges = []
    for sign in (-1.0, 1.0):
        side = np.full(len(along), sign * width / 2.0)
        end = np.full(len(across), sign * length / 2.0)
        edges.append(np.column_stack([along, side]))
        edges.append(np.column_stack([end, across]))
    return np.concatenate(edges)


def _centred(length: float) -> np.ndarray:
    """Return coordinates (n,) [m] from -length / 2 to length / 2, at most OUTLINE_M apart."""
    steps = int(np.ceil(length / OUTLINE_M))
    return np.linspace(-length / 2.0, length / 2.0, steps + 1)


def parameter_values(space: Space, units: Mapping[str, str] = {}) -> List[Dict[str, Any]]:
    """Return names, ranges, default values and units of parameters as JSON values.

    Args:
        space: Space of the parameters.
        units: {name: unit} of the parameters, as far as they are known.
    """
    parameters = []
    for i, name in enumerate(space.names):
        values = {
            "name": name,
            "unit": units.get(name, ""),
            "low": float(space.low[i]),
            "high": float(space.high[i]),
            "default": float(space.theta0[i]),
        }
        parameters.append(values)
    return parameters


def scene_values(scene: Scene, marked: bool = False) -> Dict[str, Any]:
    """Return a scene as SCENE reads it. Lengths are in cm, those of circles in mm.

    Args:
        scene: World with its drives.
        marked: Whether the planner used predicted obstacle points.
    """
    world = scene.world
    course = world.course
    drives = []
    places = [np.array([course.start[:2]])]
    for shown in scene.drives:
        drives.append(_drive(shown))
        poses, _ = sampled(shown.drive)
        places.append(poses[:, :2])

    # Only obstacles near a driven path are shown: a world may be much larger.
    driven = np.concatenate(places)
    low = driven.min(axis=0)
    high = driven.max(axis=0)
    circles = _near(world.cylinders, world.cylinders[:, 2], low, high)
    size_x, size_y = world.boxes[:, 3:].T
    boxes = _near(world.boxes, np.hypot(size_x, size_y) / 2.0, low, high)

    # In x the view holds all obstacles that are shown. In y it has room for those beside a drive
    # along x, and a margin before and behind a drive along y.
    x = np.concatenate([driven[:, 0], circles[:, 0], boxes[:, 0]])
    extent_x, extent_y = high - low
    margin = ASIDE_M if extent_x > extent_y else MARGIN_M
    view = [x.min() - SIDE_M, low[1] - margin, x.max() + SIDE_M, high[1] + margin]

    pose_count = max(len(drive["p"]) for drive in drives)
    times = (scene.begins + POSE_PERIOD_S * np.arange(pose_count)).tolist()
    movers = []
    for mover in world.movers:
        positions = list(map(mover.position, times))
        movers.append([round(100 * mover.radius), _whole(positions, 100)])
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
    values: Dict[str, Any] = {
        "m": shown.method,
        "k": shown.trial,
        "t": round(goal.end - goal.begin, 1),
        "ok": goal.status == REACHED,
        "hit": bool(len(drive.contacts)),
        "why": goal.reason,
        # Differences have fewer digits than poses.
        "p": np.diff(np.rint(poses * 100.0).astype(int), axis=0, prepend=0).tolist(),
        "v": _whole(speeds, 100),
    }
    # When a goal has ended, the defaults are set again. The observation there has no parameters.
    assert drive.truth is not None
    end = drive.truth.time[-1]
    times = []
    sets = []
    for decision in drive.decisions:
        if decision.after and decision.time <= end:
            times.append(decision.time)
            sets.append(_short(decision.after))
    if times:
        values["at"] = _whole(times, 100)
        values["theta"] = sets
    return values


def _short(parameters: Mapping[str, float]) -> List[float]:
    """Return the values of parameters with DIGITS significant digits."""
    return [float(f"{value:.{DIGITS}g}") for value in parameters.values()]


def sampled(drive: Drive) -> Tuple[np.ndarray, np.ndarray]:
    """Return poses (n, 3) and speeds (n,) of a drive, one per POSE_PERIOD_S and the last one."""
    drive.require("truth")
    assert drive.truth is not None
    motion = drive.truth
    begin = motion.time[0]
    end = motion.time[-1]
    times = np.unique(np.append(np.arange(begin, end, POSE_PERIOD_S), end))
    x = np.interp(times, motion.time, motion.pose[:, 0])
    y = np.interp(times, motion.time, motion.pose[:, 1])
    yaw = np.interp(times, motion.time, np.unwrap(motion.pose[:, 2]))
    speeds = np.interp(times, motion.time, motion.twist[:, 0])
    return np.column_stack([x, y, yaw]), speeds


def _near(
    obstacles: np.ndarray, radius: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return the obstacles within ASIDE_M of the box from `low` to `high`.

    Args:
        obstacles: (n, ...) x, y [m] and further columns.
        radius: (n,) radius of each obstacle [m].
        low: (2,) least x, y [m].
        high: (2,) largest x, y [m].
    """
    reach = ASIDE_M + radius[:, None]
    places = obstacles[:, :2]
    is_near = (places > low - reach) & (places < high + reach)
    return obstacles[is_near.all(axis=1)]


def _whole(values: Any, scale: float) -> Any:
    """Return values times `scale`, rounded to integers."""
    return np.rint(np.asarray(values, dtype=np.float64) * scale).astype(int).tolist()
