"""Replay of a recorded drive: every control cycle of the local planner again, at the recorded pose and speed.

A bag does not contain which odometry message, scan and map update a cycle used. A cycle is reproduced if a likely
choice gives the recorded command. The replay continues from the map and the memory of that choice.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import product
from operator import itemgetter
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
from tqdm import tqdm

from applr_ros1.common.angles import Pose
from applr_ros1.common.scan import PointCloud, observe
from applr_ros1.planner.local_planner import Command
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.robots import Robot
from training.bags.recording import Recording
from training.env.episode import counting_cells

EQUAL = 1e-6  # largest difference between equal commands [m/s + rad/s]
SAME_CYCLE_S = 0.01  # longest time between a command and the plan that its cycle published [s]
LAGS = 0, 1, 2, -1, 3, 4  # ages of a velocity in messages, counted from the latest before the command
POSE_LAGS = 0, 1, -1, 2, -2  # ages of a pose relative to the velocity
# Choices of a cycle's map update: ages of the scan and of the odometry message, None for no update
UPDATES: Tuple[Tuple[Optional[int], int], ...] = (0, 1), (0, 0), (1, 1), (1, 0), (1, 2), (2, 1), (2, 2), (None, 0)

Map = Tuple[np.ndarray, ...]  # snapshot of the local costmap
Settings = Dict[str, Dict[str, Any]]  # parameters in force by server


@dataclass
class Cycle:
    """Control cycle of a replay."""

    at: float  # time of its command [s]
    command: Command  # recorded command (v [m/s], w [rad/s])
    pose: Pose  # pose of the robot in the odometry frame
    twist: Command  # measured (v, w) of the robot
    plan: np.ndarray  # plan (n, 3) that was followed, in the odometry frame
    map: Map  # local costmap
    memory: List[float]  # flags of the planner before the cycle
    is_new: bool  # whether the plan was new, which may clear the flags
    settings: Settings  # parameters in force
    scan: int  # index of the latest scan
    error: float = np.inf  # difference between the replayed and the recorded command [m/s + rad/s]

    @property
    def reproduced(self) -> bool:
        """True if the replayed command equals the recorded one."""
        return self.error < EQUAL


class Replay:
    """Planner of a robot that replays a drive; `run` fills `cycles`."""

    def __init__(self, robot: Robot):
        self.recording = Recording()
        self.cycles: List[Cycle] = []
        self.move_base = MoveBase(counting_cells(robot.parameters()))
        self.local: Any = self.move_base.local_planner
        self.costmap, self.server = self.move_base.local_costmap, self.move_base.local_planner_name
        self.period = 1.0 / max(self.move_base.configuration("")["controller_frequency"], 1.0)  # control period [s]
        self.settings: Settings = {
            name: {one.name: self.move_base.configuration(name)[one.name] for one in server.parameters}
            for name, server in self.move_base.servers.items()
            if name
        }

    @property
    def share(self) -> float:
        """Share of the cycles that are reproduced."""
        return float(np.mean([cycle.reproduced for cycle in self.cycles]))

    def __str__(self) -> str:
        count = f"{sum(cycle.reproduced for cycle in self.cycles):,} of {len(self.cycles):,} commands reproduced"
        note = "" if self.recording.updates else "; no parameter_updates: the folder's values are assumed"
        return f"{self.recording.path.name}: {self.cycles[-1].at:.1f} s, {count} ({self.share:.1%}){note}"

    def run(self, recording: Recording) -> None:
        """Replay all cycles of a recording."""
        self.recording, updates = recording, list(recording.updates)
        for at, v, w in tqdm(recording.commands, str(recording.path), leave=False, disable=None):
            while updates and updates[0][0] <= at:
                _, server, given = updates.pop(0)
                values = {name: given.get(name, value) for name, value in self.settings.get(server, {}).items()}
                self.settings = {**self.settings, server: values} if values else self.settings
            self.put_in_force(self.settings)
            odometry, scan = (_latest(rows, at) for rows in (recording.odometry, recording.scans))
            plan = self._plan(at)
            if odometry >= 0 and scan >= 0 and plan is not None:
                (_, pose, twist), memory = recording.odometry[odometry], self.local.planner.state
                known = self.costmap.snapshot()
                cycle = Cycle(at, (v, w), pose, twist, plan, known, memory, False, self.settings, scan)
                self.cycles.append(self._replayed(cycle, odometry))

    def put_in_force(self, settings: Settings) -> None:
        """Set the parameters of the local planner and of the costmaps' layers."""
        for server, values in settings.items():
            now = self.move_base.configuration(server)
            changed = {n: v for n, v in values.items() if now.get(n) != v and n != "restore_defaults"}
            if changed:
                self.move_base.reconfigure(server, changed)

    def _plan(self, at: float) -> Optional[np.ndarray]:
        """Return the plan of the cycle at a time, or None if there was no plan.

        DWAPlannerROS publishes an empty plan if it finds no command. Its plan is then the one before.
        """
        rows = self.recording.followed
        last = _latest(rows, at + SAME_CYCLE_S)
        if last < 0 or rows[last][0] < at - SAME_CYCLE_S:
            return None
        return next((plan for _, plan in rows[last::-1] if len(plan)), None)

    def _update(self, scan: int, odometry: int) -> None:
        """Update the local costmap with a scan at the pose of an odometry message."""
        self.costmap.update(self.recording.odometry[odometry].pose, self.cloud(scan))

    def cloud(self, index: int) -> PointCloud:
        """Return the points of a scan in the odometry frame, as the local costmap takes them."""
        return observe(self.recording.scans[index][1], self.costmap.obstacles.buffers[0].source.inf_is_valid)

    def command(self, cycle: Cycle) -> Command:
        """Return the planner's command in a cycle, on the present map and with the parameters in force."""
        self.begin(cycle)
        command: Command = self.local.compute_velocity(cycle.pose, cycle.twist, self.costmap)[1]
        return command

    def begin(self, cycle: Cycle) -> None:
        """Give the planner the plan and the flags of a cycle."""
        self.local.planner.state = cycle.memory
        self.local.set_plan(cycle.plan)
        if not cycle.is_new:
            self.local.planner.state = cycle.memory

    def _replayed(self, asked: Cycle, odometry: int) -> Cycle:
        """Return a cycle with the first choice that reproduces it, else with the first choice and the least error.

        The planner keeps the flags after the recorded command, and the map of the choice is shown.
        """
        first, least = None, np.inf
        for cycle in self._choices(asked, odometry):
            v, w = self.command(cycle)
            cycle.error = abs(v - asked.command[0]) + abs(w - asked.command[1])
            if cycle.reproduced:
                return cycle
            first, least = first or cycle, min(least, cycle.error)
        assert first is not None
        self.costmap.restore(first.map)
        self.local.planner.state = first.memory
        self.local.planner.remember(first.pose, *first.command)
        return replace(first, error=least)

    def _choices(self, asked: Cycle, odometry: int) -> Iterator[Cycle]:
        """Yield the choices of a cycle's messages and map, the likely ones first, with the map shown."""
        messages = self.recording.odometry
        self.begin(replace(asked, is_new=True))
        plans = (False,) if self.local.planner.state == asked.memory else (False, True)
        for behind, late in UPDATES:
            if asked.scan >= (behind or 0) and odometry >= late:
                self.costmap.restore(asked.map)
                if behind is not None:
                    self._update(asked.scan - behind, odometry - late)
                shown = self.costmap.snapshot()
                for lag, shift, is_new in product(LAGS, POSE_LAGS, plans):
                    row = odometry - lag
                    if 0 <= row < len(messages) and 0 <= row + shift < len(messages):
                        pose, twist = messages[row + shift].pose, messages[row].twist
                        yield replace(asked, pose=pose, twist=twist, map=shown, is_new=is_new)


def _latest(rows: Sequence[Any], at: float) -> int:
    """Return the index of the latest of rows with times until a time, -1 if there is none."""
    return bisect_right(rows, at, key=itemgetter(0)) - 1
