"""Replay of a recorded drive: every control cycle of the local planner at its pose and speed.

A bag does not contain which odometry message, scan and map update a cycle used. A cycle is
reproduced if a likely choice gives the recorded command. The replay continues from the map and the
memory of that choice.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, replace
from itertools import product
from operator import itemgetter
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Set, Tuple

import numpy as np
from tqdm import tqdm
from typing_extensions import override

from applr_ros1.common.angles import Pose, compose
from applr_ros1.common.scan import LaserScan, PointCloud, observe
from applr_ros1.drives.drive import Commands, Drive, Motion, Plans, Scans
from applr_ros1.planner.local_planner import Command
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import Settings, send
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from training.env.episode import counting_cells
from training.why.events import Limits

# Reasons why a command is no cycle of the local planner
WITHOUT_PLAN = "without a plan (stops and recoveries of move_base)"
TOO_EARLY = "before the first scan or odometry"
EQUAL = 1e-6  # largest difference between equal commands [m/s + rad/s]
CLEARED_S = 0.5  # longest time in which move_base clears its costmaps after a call [s]
SAME_CYCLE_S = 0.01  # longest time between a command and the plan that its cycle published [s]
# Ages of a velocity in messages, counted from the latest before the command, the likely ones first.
LAGS = 0, 1, 2, -1, 3, 4
POSE_SHIFTS = 0, 1, -1, 2, -2  # messages by which a pose is newer than the velocity
# Choices of a cycle's map update: ages of the scan and of the odometry message, None for no update.
UPDATES: Tuple[Tuple[Optional[int], int], ...] = (
    (0, 1),
    (0, 0),
    (1, 1),
    (1, 0),
    (1, 2),
    (2, 1),
    (2, 2),
    (None, 0),
)

Map = Tuple[np.ndarray, ...]  # snapshot of the local costmap


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
    is_cleared: bool = False  # whether the costmap was cleared since the cycle before
    error: float = np.inf  # difference between the replayed and the recorded command [m/s + rad/s]

    @property
    def reproduced(self) -> bool:
        """True if the replayed command equals the recorded one."""
        return self.error < EQUAL


class Replayable(NamedTuple):
    """Columns of a drive that can be replayed."""

    planned: Commands
    odometry: Motion
    scans: Scans
    plans: Plans


class Replay:
    """Planner of a robot that replays a drive; `run` fills `cycles`."""

    def __init__(self, robot: Robot):
        self.robot = robot
        self.drive = Drive()
        self.cycles: List[Cycle] = []
        self.left_out: Counter[str] = Counter()  # numbers of commands that are no cycles, by reason
        self.move_base = MoveBase(counting_cells(robot.parameters()))
        self.local: Any = self.move_base.local_planner
        self.costmap = self.move_base.local_costmap
        self.server = self.move_base.local_planner_name
        rate = self.move_base.configuration("")["controller_frequency"]
        self.period = 1.0 / max(rate, 1.0)  # control period [s]
        start_settings = Settings.from_tree(self.move_base.parameters)
        values_by_server = {}
        for server in start_settings:
            # The values of move_base itself (server "") stay as they are while it drives.
            if server:
                values_by_server[server] = start_settings[server]
        self.settings = Settings(values_by_server)
        self.history = [(-math.inf, self.settings)]  # (time [s], settings in force from then on)
        self._clearings: List[float] = []  # calls to clear the costmaps, not yet replayed [s]

    @property
    def reproduced(self) -> int:
        """Number of reproduced commands."""
        return sum(cycle.reproduced for cycle in self.cycles)

    @property
    def commands(self) -> int:
        """Number of all commands of the drive."""
        return len(self.cycles) + self.left_out.total()

    @property
    def share(self) -> float:
        """Share of all commands that are reproduced."""
        return self.reproduced / self.commands

    @property
    def share_of_cycles(self) -> float:
        """Share of the local planner's commands that are reproduced."""
        return self.reproduced / len(self.cycles)

    @override
    def __str__(self) -> str:
        summary = (
            f"{self.drive.name}: {self.cycles[-1].at:.1f} s, {self.reproduced:,} of "
            f"{self.commands:,} commands reproduced ({self.share:.1%})"
        )
        left_out = []
        for reason, command_count in self.left_out.items():
            left_out.append(f"{command_count:,} {reason}")
        if left_out:
            summary += f"; left out: {', '.join(left_out)}"
        if not self.drive.changes:
            summary += "; no parameter_updates: the folder's values are assumed"
        return summary

    def run(self, drive: Drive) -> None:
        """Replay all cycles of a drive.

        Raises:
            DriveError: The drive lacks commands, odometry, scans or plans.
        """
        self.drive = drive
        planned = drive.require(Replayable).planned

        # Parameters in force from each change on
        for change_time, server, values in changes_of(drive, self.robot):
            changes = self.settings.differences({server: values})
            self.settings = self.settings.with_(*changes)
            self.history.append((change_time, self.settings))

        for decision in drive.decisions:
            if decision.cleared:
                self._clearings.append(decision.time)

        # Cycles in order: each one continues from the map and the flags of the one before
        commands = list(zip(planned.time.tolist(), planned.twist.tolist()))
        for command_time, (v, w) in tqdm(commands, drive.name, leave=False, disable=None):
            settings = self.in_force(command_time)
            self.put_in_force(settings)
            odometry_row = self.odometry.latest(command_time)
            scan_row = self._scans.latest(command_time)
            plan = self._plan(command_time)
            if plan is None:
                self.left_out[WITHOUT_PLAN] += 1
                continue
            if odometry_row < 0 or scan_row < 0:
                self.left_out[TOO_EARLY] += 1
                continue
            pose, twist = self.measured(odometry_row)
            cycle = Cycle(
                at=command_time,
                command=(v, w),
                pose=pose,
                twist=twist,
                plan=plan,
                map=self.costmap.snapshot(),
                memory=self.local.planner.state,
                is_new=False,
                settings=settings,
                scan=scan_row,
            )
            cycle = self._replayed(cycle, odometry_row)
            self.cycles.append(cycle)
            # A call that no cycle shows within this time had failed.
            if cycle.is_cleared or self._clears(command_time - CLEARED_S):
                self._clearings.pop(0)

    def in_force(self, at: float) -> Settings:
        """Return the parameters in force at a time [s]."""
        row = bisect_right(self.history, at, key=itemgetter(0)) - 1
        return self.history[row][1]

    def between(self, begin: float, end: float) -> List[Cycle]:
        """Return the cycles between two times [s]."""
        return [cycle for cycle in self.cycles if begin <= cycle.at <= end]

    def limits(self) -> Limits:
        """Return what the drive is measured by."""
        speeds = []
        turn_rates = []
        for row_time in self.odometry.time.tolist():
            values = self.in_force(row_time)[self.server]
            speeds.append(values["max_vel_x"])
            turn_rates.append(values["max_vel_theta"])
        return Limits(
            speed=np.array(speeds),
            turn=np.array(turn_rates),
            tolerance=self.move_base.goal_tolerance,
            scale=self.robot.world_scale,
        )

    @property
    def top_speed(self) -> float:
        """Mean top speed that the planner allows [m/s]."""
        return float(self.limits().speed.mean())

    @property
    def odometry(self) -> Motion:
        """Odometry of the drive."""
        assert self.drive.odometry is not None
        return self.drive.odometry

    @property
    def _scans(self) -> Scans:
        assert self.drive.scans is not None
        return self.drive.scans

    def measured(self, odometry_row: int) -> Tuple[Pose, Command]:
        """Return pose and velocity that the planner was given with an odometry message."""
        twists = self.drive.planner_twist
        if twists is None:
            twists = self.odometry.twist
        x, y, yaw = self.odometry.pose[odometry_row].tolist()
        v, w = twists[odometry_row].tolist()
        return (x, y, yaw), (v, w)

    def put_in_force(self, settings: Settings) -> None:
        """Set the parameters of the local planner and of the costmaps' layers."""
        send(settings, self.move_base)

    def _plan(self, at: float) -> Optional[np.ndarray]:
        """Return the plan of the cycle at a time, or None if there was no plan.

        DWAPlannerROS publishes an empty plan if it finds no command. Its plan is then the one
        before.
        """
        assert self.drive.plans is not None
        plans = self.drive.plans
        plan_row = plans.latest(at + SAME_CYCLE_S)
        if plan_row < 0 or plans.time[plan_row] < at - SAME_CYCLE_S:
            return None
        for plan_path in plans.path[plan_row::-1]:
            if len(plan_path):
                return plan_path
        return None

    def _paths(self, asked: Cycle) -> List[np.ndarray]:
        """Return the plan of a cycle, and the one before it if either may have been followed."""
        assert self.drive.plans is not None
        plans = self.drive.plans
        plan_row = plans.latest(asked.at)
        if plan_row > 0 and plans.time[plan_row - 1] == plans.time[plan_row] == asked.at:
            return [asked.plan, plans.path[plan_row - 1]]
        return [asked.plan]

    def _clears(self, time: float) -> bool:
        """Return whether a call to clear the costmaps, made until `time` [s], is to be replayed."""
        return bool(self._clearings) and self._clearings[0] <= time

    def _maps(self, asked: Cycle) -> List[Tuple[Map, bool]]:
        """Return the map before a cycle, and whether it is cleared.

        If it may have been cleared since the cycle before, the cleared map comes first.
        """
        if not self._clears(asked.at):
            return [(asked.map, False)]
        self.costmap.restore(asked.map)
        self.costmap.clear()
        return [(self.costmap.snapshot(), True), (asked.map, False)]

    def _update(self, scan_row: int, odometry_row: int) -> None:
        """Update the local costmap with a scan at the pose of an odometry message."""
        pose, _ = self.measured(odometry_row)
        self.costmap.update(pose, self.cloud(scan_row))

    def cloud(self, scan_row: int) -> PointCloud:
        """Return the points of a scan in the odometry frame, as the local costmap takes them."""
        return observe(self.scan(scan_row), self.costmap.obstacles.buffers[0].source.inf_is_valid)

    def scan(self, scan_row: int) -> LaserScan:
        """Return a scan at the laser's place in the odometry frame at the time of its stamp."""
        laser = self.robot.laser
        scan_stamp = self._scans.stamp[scan_row]
        first_angle, increment, range_min, range_max = self._scans.fan[scan_row].tolist()
        robot_pose = self.odometry.pose_at(scan_stamp)
        laser_place = compose(robot_pose, self.drive.laser_pose or laser.pose)
        ranges = self._scans.ranges[scan_row]
        return LaserScan(
            stamp=0.0,
            angle_min=first_angle,
            angle_increment=increment,
            range_min=range_min,
            range_max=range_max,
            ranges=ranges,
            sensor_pose=laser_place,
            sensor_height=laser.height,
        )

    def command(self, cycle: Cycle) -> Command:
        """Return the planner's command in a cycle, on the present map, with the present values."""
        self.begin(cycle)
        command: Command = self.local.compute_velocity(cycle.pose, cycle.twist, self.costmap)[1]
        return command

    def begin(self, cycle: Cycle) -> None:
        """Give the planner the plan and the flags of a cycle."""
        self.local.planner.state = cycle.memory
        # A new plan may clear flags. The same plan, given again, must not.
        self.local.set_plan(cycle.plan)
        if not cycle.is_new:
            self.local.planner.state = cycle.memory

    def _replayed(self, asked: Cycle, odometry_row: int) -> Cycle:
        """Return a cycle with the first choice that reproduces it, else with the first choice.

        The error is the least one of all choices. The planner keeps the flags after the recorded
        command, and the costmap shows the map of the choice.
        """
        first_choice: Optional[Cycle] = None
        least_error = np.inf
        for cycle in self._choices(asked, odometry_row):
            v, w = self.command(cycle)
            recorded_v, recorded_w = asked.command
            cycle.error = abs(v - recorded_v) + abs(w - recorded_w)
            if cycle.reproduced:
                return cycle
            first_choice = first_choice or cycle
            least_error = min(least_error, cycle.error)
        assert first_choice is not None
        self.costmap.restore(first_choice.map)
        # The robot did what was recorded, whatever the replay would have done.
        self.local.planner.state = first_choice.memory
        self.local.planner.remember(first_choice.pose, *first_choice.command)
        return replace(first_choice, error=least_error)

    def _choices(self, asked: Cycle, odometry_row: int) -> Iterator[Cycle]:
        """Yield the choices of a cycle's messages and map, the likely ones first.

        The costmap shows the map of the yielded choice.
        """
        is_new_choices = self._choices_of_new(asked)
        paths = self._paths(asked)
        maps = self._maps(asked)
        for (map_before, is_cleared), (scan_age, odometry_age) in product(maps, UPDATES):
            if asked.scan < (scan_age or 0) or odometry_row < odometry_age:
                continue
            self.costmap.restore(map_before)
            if scan_age is not None:
                self._update(asked.scan - scan_age, odometry_row - odometry_age)
            map_shown = self.costmap.snapshot()
            choices = product(LAGS, POSE_SHIFTS, is_new_choices, paths)
            for twist_lag, pose_shift, is_new, plan_path in choices:
                twist_row = odometry_row - twist_lag
                pose_row = twist_row + pose_shift
                if min(twist_row, pose_row) < 0:
                    continue
                if max(twist_row, pose_row) >= len(self.odometry):
                    continue
                pose, _ = self.measured(pose_row)
                _, twist = self.measured(twist_row)
                yield replace(
                    asked,
                    pose=pose,
                    twist=twist,
                    map=map_shown,
                    plan=plan_path,
                    is_new=is_new,
                    is_cleared=is_cleared,
                )

    def _choices_of_new(self, asked: Cycle) -> Tuple[bool, ...]:
        """Return whether the plan of a cycle may have been new, if that makes a difference."""
        self.begin(replace(asked, is_new=True))
        clears_flags = self.local.planner.state != asked.memory
        return (False, True) if clears_flags else (False,)


def changes_of(drive: Drive, robot: Robot) -> List[Tuple[float, str, Dict[str, Any]]]:
    """Return the changes (time [s], server, {name: value}) of a drive in order of time.

    Of servers without recorded updates, the values come from the decisions.
    """
    changes: List[Tuple[float, str, Dict[str, Any]]] = []
    recorded_servers: Set[str] = set()
    if drive.changes is not None:
        changes += zip(drive.changes.time.tolist(), drive.changes.server, drive.changes.values)
        recorded_servers.update(drive.changes.server)
    for decision in drive.decisions:
        for server, values in space_of(robot).settings_of(decision.after).items():
            if server not in recorded_servers:
                changes.append((decision.time, server, dict(values)))
    changes.sort(key=itemgetter(0))
    return changes
