"""Explanation of a cycle from the planner's own numbers: what outbid or refused the samples that drive on."""

from __future__ import annotations

from collections import Counter
from operator import itemgetter
from typing import Any, Dict, List, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse, transform_point
from applr_ros1.planner.costmap.grid import LETHAL
from training.why.events import SLOW
from training.why.replay import Cycle, Replay

FASTEST = (
    0.95  # share of the fastest sample's speed from which a sample drives on, if this is below SLOW
)
SCANS, TURNED, CARRIED = (
    24,
    1.0,
    0.9,
)  # number of scans, turn [rad] and share of scans that show a part of the robot
SAMPLES = 12  # number of samples in a table
STEP_S = 0.1  # interval between the poses at which an illegal sample is checked [s]
NEAR_M = 0.1  # distance from an obstacle cell within which a point of a scan shows it [m]


def explain(replay: Replay, cycle: Cycle) -> Dict[str, Any]:
    """Return what kept the robot from driving on in a cycle, as JSON values for the page.

    Returns:
        at, pose: Time [s] and pose (x, y, yaw) of the cycle.
        lines: What outbid the cheapest sample that drives on, and what refused the illegal ones, as sentences.
        obstacle: Cell (x, y) [m] that the straightest illegal sample meets, in the odometry frame, or None.
        points: Points (x, y, cost) of the legal trajectories.
        table: Names, the command, the cheapest sample that drives on, and the cheapest samples: v [m/s], w [rad/s],
            cost and its parts.
    """
    replay.put_in_force(cycle.settings)
    replay.costmap.restore(cycle.map)
    command, values, lines, obstacle = (
        replay.command(cycle),
        cycle.settings[replay.server],
        [],
        None,
    )
    velocities, costs, parts = replay.local.planner.sample_costs(replay.costmap, command)
    fast = velocities[:, 0] >= min(SLOW * values["max_vel_x"], FASTEST * velocities[:, 0].max())
    legal, illegal = np.flatnonzero(fast & (costs >= 0)), np.flatnonzero(fast & (costs < 0))
    best = legal[costs[legal].argsort()][:1]
    winner = np.abs(velocities - command).sum(axis=1).argmin()
    chosen = "({:.2f} m/s, {:.2f} rad/s)".format(*velocities[winner])
    if fast[winner]:
        lines.append(f"The planner drives on {chosen}.")
    elif len(best):
        driving = "Driving on ({:.2f} m/s, {:.2f} rad/s)".format(*velocities[best[0]])
        name = max(parts, key=lambda part: parts[part][best[0]] - parts[part][winner])
        weight = f"{name} ({values[name]:g})" if name in values else f"the critic {name}"
        counts = f"{weight} counts {parts[name][best[0]]:.1f} against {parts[name][winner]:.1f}"
        text = f"{driving} costs {costs[best[0]]:.1f}, the command {chosen} {costs[winner]:.1f}: {counts}."
        if not 0.0 <= costs[winner] <= costs[best[0]]:
            text = f"{driving} was not sampled, because the robot was escaping (escape_reset_dist, escape_reset_theta)."
        lines.append(text)
    if len(illegal):
        row = illegal[np.abs(velocities[illegal, 1]).argmin()]
        (v, w), refusing = velocities[row], [name for name in parts if parts[name][row] < 0]
        limits = [
            f"{name} ({values[name]:g})"
            for name in ("min_vel_trans", "min_vel_theta")
            if "min_vel_trans" in values
        ]
        why = (
            f"is below {' and '.join(limits)}"
            if limits
            else "leaves the map or the reach of the plan"
        )
        why = f"is refused by the critic {refusing[0]}" if refusing else why
        obstacle = _obstacle(replay, cycle.pose, v, w, values["sim_time"])
        if obstacle:
            (x, y), (ahead, left) = obstacle, transform_point(inverse(cycle.pose), *obstacle)
            gap = np.hypot(*(replay.cloud(cycle.scan).points[:, :2] - obstacle).T).min(
                initial=np.inf
            )
            source = "the latest scan" if gap < NEAR_M else "earlier scans"
            side = f"{ahead:.2f} m ahead and {abs(left):.2f} m to the {'left' if left > 0 else 'right'}"
            why = f"meets the obstacle at ({x:.2f}, {y:.2f}), {side}, from {source}"
        lines.append(
            f"{len(illegal)} of {fast.sum()} faster samples are illegal; ({v:.2f} m/s, {w:.2f} rad/s) {why}."
        )
    rows = np.column_stack([velocities, costs, *parts.values()]).round(2)
    cheapest = [row for row in costs.argsort() if costs[row] >= 0][:SAMPLES]
    table = [
        ["v", "w", "cost", *parts],
        *rows[list(dict.fromkeys([winner, *best, *cheapest]))].tolist(),
    ]
    points = replay.local.trajectory_cloud(replay.costmap)[:, [0, 1, 4]].round(2).tolist()
    return dict(
        at=cycle.at, pose=cycle.pose, lines=lines, obstacle=obstacle, points=points, table=table
    )


def part_of_robot(replay: Replay) -> Optional[Tuple[float, float]]:
    """Return the place (x, y) beside the robot where nearly all scans have a point although it turned, or None."""
    cycles, places = (
        replay.cycles[:: max(len(replay.cycles) // SCANS, 1)],
        Counter[Tuple[float, float]](),
    )
    for cycle in cycles:
        points = np.column_stack(
            transform_point(inverse(cycle.pose), *replay.cloud(cycle.scan).points[:, :2].T)
        )
        places.update({(x, y) for x, y in (np.rint(points / NEAR_M) * NEAR_M).tolist()})
    (place, count), turned = (
        max(places.items(), key=itemgetter(1)),
        np.ptp(np.unwrap([one.pose[2] for one in cycles])),
    )
    return place if count > CARRIED * len(cycles) and turned > TURNED else None


def arc(pose: Pose, v: float, w: float, seconds: float) -> Pose:
    """Return the pose after some time of driving with a constant command (v, w)."""
    turn = w * seconds
    chord = v * seconds * np.sinc(0.5 * turn / np.pi)
    return compose(pose, (chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn))


def lethal_points(replay: Replay) -> np.ndarray:
    """Return the centres (n, 2) [m] of the lethal cells of the local costmap."""
    rows, columns = np.nonzero(replay.costmap.cells == LETHAL)
    return (
        replay.costmap.origin + (np.column_stack([columns, rows]) + 0.5) * replay.costmap.resolution
    )


def _obstacle(
    replay: Replay, start: Pose, v: float, w: float, seconds: float
) -> Optional[List[float]]:
    """Return the lethal cell (x, y) that is nearest to the footprint where it first meets an obstacle, or None."""
    lethal, outline = lethal_points(replay), replay.costmap.footprint
    for time in np.arange(0.0, seconds, STEP_S) if len(lethal) else ():
        pose = arc(start, v, w, time)
        if replay.costmap.footprint_cost(*pose) < 0:
            inside = np.column_stack(transform_point(inverse(pose), *lethal.T))
            outside = np.hypot(
                *(inside - np.clip(inside, outline.min(axis=0), outline.max(axis=0))).T
            )
            cell: List[float] = lethal[outside.argmin()].round(3).tolist()
            return cell
    return None
