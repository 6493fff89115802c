"""Self-contained web page that animates drives side by side, world by world.

The page of an evaluation's report shows all drives whose paths were recorded, and the page of the
demo its single drive. The script in page.html draws the drives. All values are integers, to keep
the file small.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from applr_ros1.common.files import read_bytes
from applr_ros1.drives.drive import REACHED, Drive
from applr_ros1.policy.parameter_space import Space
from worlds.world import World

TEMPLATE = Path(__file__).with_name("page.html")
POSE_PERIOD_S = 0.2  # interval between two poses of a drive [s]
MARGIN_M = 1.2  # margin of the view before and behind the driven path [m]
# Distance beside the driven path up to which obstacles are shown [m]; BARN's fields are 4.5 m wide
ASIDE_M = 3.5
SIDE_M = 0.3  # margin of the view beside the outermost obstacles [m]


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
    methods: Mapping[str, str],
    space: Space,
    body: Sequence[float],
    scenes: Sequence[Scene],
    marked: bool = False,
    back: str = "",
) -> bytes:
    """Return the HTML of the page, encoded in UTF-8.

    Args:
        title: Title of the page.
        methods: {name: colour} in the order of Shown.method.
        space: Space of the parameters.
        body: Length and width of the robot [m].
        scenes: One or more worlds with their drives.
        marked: Whether the planner used predicted obstacle points.
        back: HTML of a link above the page.
    """
    values = {
        "title": title,
        "methods": [{"name": name, "color": color} for name, color in methods.items()],
        "parameters": list(space.names),
        "period": POSE_PERIOD_S,
        "body": list(body),
        "marked": marked,
        "worlds": [_scene(scene, space) for scene in scenes],
    }
    # A name with a tag would end the script that holds the data.
    data = json.dumps(values, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    data = data.replace("</", "<\\/")
    return read_bytes(TEMPLATE).replace(b"@BACK@", back.encode()).replace(b"@DATA@", data.encode())


def _scene(scene: Scene, space: Space) -> Dict[str, Any]:
    """Return a scene as the page's script reads it. Lengths are in cm, those of circles in mm."""
    world = scene.world
    course = world.course
    drives = [_drive(shown, space) for shown in scene.drives]

    # Only obstacles near a driven path are shown: a world may be much larger.
    places = [np.array([course.start[:2]])]
    for shown in scene.drives:
        poses, _ = _sampled(shown.drive)
        places.append(poses[:, :2])
    driven = np.concatenate(places)
    low = driven.min(axis=0)
    high = driven.max(axis=0)
    circles = _near(world.cylinders, world.cylinders[:, 2], low, high)
    boxes = _near(world.boxes, np.hypot(world.boxes[:, 3], world.boxes[:, 4]) / 2.0, low, high)

    # The view has margins before and behind the path, and the obstacles at its sides.
    sides = np.concatenate([driven[:, 0], circles[:, 0], boxes[:, 0]])
    is_along_x = np.ptp(driven[:, 0]) > np.ptp(driven[:, 1])
    margin = ASIDE_M if is_along_x else MARGIN_M
    view = [sides.min() - SIDE_M, low[1] - margin, sides.max() + SIDE_M, high[1] + margin]

    pose_count = max(len(drive["p"]) for drive in drives)
    times = (scene.begins + POSE_PERIOD_S * np.arange(pose_count)).tolist()
    movers = []
    for mover in world.movers:
        positions = [mover.position(time) for time in times]
        movers.append([round(100 * mover.radius), _whole(positions, 100)])
    return {
        "name": scene.name,
        "view": _whole(view, 100),
        "circles": _whole(circles, 1000),
        "boxes": _whole(boxes, 100),
        "movers": movers,
        "start": _whole(course.start, 100),
        "goal": _whole([*course.goal[:2], course.goal_tolerance], 100),
        "finish": None if course.finish_y is None else round(100 * course.finish_y),
        "drives": drives,
    }


def _drive(shown: Shown, space: Space) -> Dict[str, Any]:
    """Return a drive as the page's script reads it."""
    drive = shown.drive
    goal = drive.goals[-1]
    poses, speeds = _sampled(drive)
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
    if drive.decisions:
        times = [decision.time for decision in drive.decisions]
        actions = [space.to_action(list(decision.after.values())) for decision in drive.decisions]
        values["at"] = _whole(times, 100)
        values["a"] = _whole(actions, 50)
    return values


def _sampled(drive: Drive) -> Tuple[np.ndarray, np.ndarray]:
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
