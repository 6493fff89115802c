"""drives.html: the drives of all methods side by side, world by world, as an animation that needs no other file.

page.py calls it. What is drawn comes from the traces that evaluate.py kept, thinned to five poses a second and written
as whole numbers; the script in drives_page.html draws it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Optional

import numpy as np

from applr_ros1.common.files import read_bytes, write_bytes
from training.common.folders import make_folder
from training.report.data import Results
from training.report.figures import colors

FILE = "drives.html"
TEMPLATE = Path(__file__).with_name("drives_page.html")
EVERY = 4  # control cycles between two poses that are drawn
PERIOD = 0.05 * EVERY  # s between them
MARGIN = 1.2  # m that are shown before and behind what was driven through
ASIDE = 3.5  # m to its sides in which obstacles are shown; BARN's fields are 4.5 m wide
MOST_TRIALS = 10  # of a method in a world


def write(results: Results, out: Path, title: str) -> str:
    """Writes the page into the folder `out`.

    Args:
        results: of the evaluation.
        out: the folder of the report.
        title: of the page.

    Returns:
        The file's name; "" where no trace was kept.
    """
    found = [_world(results, name) for name in results.worlds]
    worlds = [world for world in found if world is not None]
    if not worlds:
        return ""
    shade = colors(results)
    page = {
        "title": title,
        "methods": [{"name": m, "color": shade[m]} for m in results.methods],
        "planner": results.planner,
        "parameters": results.space.names,
        "period": PERIOD,
        "body": results.robot["body"],
        "marked": bool(results.settings.get("movers")),
        "worlds": worlds,
    }
    data = json.dumps(page, separators=(",", ":"), ensure_ascii=False, allow_nan=False).replace("</", "<\\/")
    write_bytes(make_folder(out) / FILE, read_bytes(TEMPLATE).replace(b"@DATA@", data.encode()))
    return FILE


def _world(results: Results, name: str) -> Optional[Dict[str, Any]]:
    """A world with its drives; None where there are none, or where the world's file has gone since."""
    drives = [drive for place, method in enumerate(results.methods) for drive in _drives(results, name, method, place)]
    world = results.load(name) if drives else None
    if world is None:
        return None
    points = [np.cumsum(drive["p"], axis=0)[:, :2] / 100.0 for drive in drives]
    points.append(np.array([world.course.start[:2]]))
    driven = np.concatenate(points)
    low, high = driven.min(axis=0), driven.max(axis=0)
    circles = _near(world.cylinders, world.cylinders[:, 2], low, high)
    boxes = _near(world.boxes, np.hypot(world.boxes[:, 3], world.boxes[:, 4]) / 2.0, low, high)
    sides = np.concatenate([driven[:, 0], circles[:, 0], boxes[:, 0]])
    times = (PERIOD * np.arange(max(len(drive["p"]) for drive in drives))).tolist()  # of the poses
    margin = ASIDE if np.ptp(driven[:, 0]) > np.ptp(driven[:, 1]) else MARGIN  # courses along x: as much beside them
    return {
        "name": name,
        "view": _whole([sides.min() - 0.3, low[1] - margin, sides.max() + 0.3, high[1] + margin], 100),
        "circles": _whole(circles, 1000),  # [mm]; all else in hundredths
        "boxes": _whole(boxes, 100),
        "movers": [[round(100 * m.radius), _whole([m.position(t) for t in times], 100)] for m in world.movers],
        "start": _whole(world.course.start, 100),
        "goal": _whole([*world.course.goal[:2], world.course.goal_tolerance], 100),
        "finish": None if world.course.finish_y is None else round(100 * world.course.finish_y),
        "drives": drives,
    }


def _drives(results: Results, world: str, method: str, place: int) -> List[Dict[str, Any]]:
    """The drives of one method in a world whose traces were kept: how each ended, and what was driven."""
    found = []
    for row in results.of(method, [world]).head(MOST_TRIALS).itertuples():
        trace = results.trace(world, method, row.trial)
        if trace is None or not len(trace["pose"]):
            continue
        last = len(trace["pose"]) - 1
        rows = np.unique(np.append(np.arange(0, last, EVERY), last))
        steps = np.rint(trace["pose"][rows] * 100.0).astype(int)
        drive: Dict[str, Any] = {
            "m": place,
            "k": row.trial,
            "t": round(row.time_s, 1),
            "ok": row.success,
            "hit": row.collided,
            "why": row.reason,
            "p": np.diff(steps, axis=0, prepend=0).tolist(),
            "v": _whole(trace["twist"][rows, 0], 100),
        }
        if len(trace["theta"]) and trace["theta"].shape[1] == len(results.space):
            drive["at"] = _whole(trace["decided"], 100)
            drive["a"] = _whole([results.space.to_action(theta) for theta in trace["theta"]], 50)
        found.append(drive)
    return found


def _near(obstacles: np.ndarray, radius: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The obstacles (n, ...) whose circles of `radius` (n,) reach the box that was driven through, or its sides."""
    reach = ASIDE + radius[:, None]
    return obstacles[np.all((obstacles[:, :2] > low - reach) & (obstacles[:, :2] < high + reach), axis=1)]


def _whole(values: Any, scale: float) -> Any:
    """Values times `scale` as whole numbers, which take the least room in a file."""
    return np.rint(np.asarray(values, dtype=np.float64) * scale).astype(int).tolist()
