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
from functools import cached_property
from itertools import chain, islice, product
from typing import (
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

import numpy as np

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import PointCloud
from applr_ros1.drives.drive import Drive
from applr_ros1.planner.parameters.parameter import RESTORE
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.robots import Robot
from applr_ros1.why.events import DriveLimits
from applr_ros1.why.limits import changes_of, limits_of
from applr_ros1.why.moment import Asked, CycleMoment, MapSnapshot, Memory
from applr_ros1.why.recording import Recording
from applr_ros1.why.rerun import Ahead, RerunPlanner

# Reasons why a command is no cycle of the local planner
WITHOUT_PLAN = "without a plan (stops and recoveries of move_base)"
TOO_EARLY = "before the first scan or odometry"
EQUAL = 1e-6  # largest difference between equal commands [m/s + rad/s]
CLEARED_S = 0.5  # longest time in which move_base clears its costmaps after a call [s]
SAME_CYCLE_S = 0.01  # longest time between a command and the plan that its cycle published [s]
PLAN_AHEAD_M = 1.0  # point of the plan that shows where it leads [m, for the Jackal]
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

# A command that no choice reproduces costs all choices. If there are many, as in a drive with other
# parameters, only the likely choices are tried from then on: as long as the planner has run
# more than HEAD_START cycles, and more than PATIENCE of them for each command so far.
HEAD_START = 10_000
PATIENCE = 60
LIKELY = 30

Watch = Callable[[Sequence[int]], Iterable[int]]  # Shows the progress of a loop over its items.


@dataclass(frozen=True)
class ReplayedCycle(Asked):
    """Control cycle of a replay.

    Attributes:
        command: Recorded command (v [m/s], w [rad/s]).
        scan: Index of the latest scan.
        is_cleared: Whether the costmap was cleared since the cycle before.
        error: Difference between the replayed and the recorded command [m/s + rad/s].
    """

    command: Twist
    scan: int
    is_cleared: bool = False
    error: float = np.inf

    @property
    def reproduced(self) -> bool:
        """True if the replayed command equals the recorded one."""
        return self.error < EQUAL


class History(NamedTuple):
    """Parameters in force during a drive.

    Attributes:
        times: Times from which on each settings are in force [s]; the first is -inf.
        settings: Settings.
    """

    times: List[float]
    settings: List[Settings]

    def at(self, time: float) -> Settings:
        """Return the parameters in force at a time [s]."""
        return self.settings[bisect_right(self.times, time) - 1]


@dataclass(frozen=True)
class Replay:
    """Replayed drive.

    Attributes:
        recording: The drive.
        planner: The robot's planner.
        history: Parameters in force.
        cycles: Cycles of the local planner in order of time.
        left_out: Numbers of commands that are no cycles, by reason.
    """

    recording: Recording
    planner: RerunPlanner
    history: History
    cycles: List[ReplayedCycle]
    left_out: Dict[str, int]

    @property
    def drive(self) -> Drive:
        """The recorded drive."""
        return self.recording.drive

    @property
    def robot(self) -> Robot:
        """Robot that drove."""
        return self.recording.robot

    @property
    def settings(self) -> Settings:
        """Parameters in force at the end."""
        return self.history.settings[-1]

    @property
    def footprint(self) -> np.ndarray:
        """Vertices (n, 2) [m] of the padded footprint at the end."""
        return self.planner.footprint(self.settings)

    @property
    def reproduced(self) -> int:
        """Number of reproduced commands."""
        return sum(cycle.reproduced for cycle in self.cycles)

    @property
    def share(self) -> float:
        """Share of the local planner's commands that are reproduced.

        Stops of move_base itself say nothing about the replay of the local planner.
        """
        return self.reproduced / len(self.cycles)

    def __str__(self) -> str:
        summary = (
            f"{self.drive.name}: {self.cycles[-1].at:.1f} s, {self.reproduced:,} of "
            f"{len(self.cycles):,} commands reproduced ({self.share:.1%})"
        )
        left_out = [f"{count:,} {reason}" for reason, count in self.left_out.items()]
        if left_out:
            summary += f"; left out: {', '.join(left_out)}"
        updated_names: Set[str] = set()
        for _, server, values in changes_of(self.drive, self.robot):
            if server == self.planner.name:
                updated_names.update(values)
        if not updated_names:
            summary += f"; no updates of {self.planner.name}: the folder's values are assumed"
        unused_names = sorted(updated_names.difference([RESTORE.name], self.planner.start_values))
        if unused_names:
            summary += f"; recorded, but not used: {', '.join(unused_names)}"
        return summary

    def between(self, begin: float, end: float) -> List[ReplayedCycle]:
        """Return the cycles between two times [s]."""
        return [cycle for cycle in self.cycles if begin <= cycle.at <= end]

    @cached_property
    def limits(self) -> DriveLimits:
        """Limits by which the drive is measured."""
        values_at_start = self.planner.start_values
        return limits_of(self.drive, self.recording.odometry, self.robot, values_at_start)

    @property
    def top_speed(self) -> float:
        """Mean top speed that the planner allows [m/s]."""
        return float(self.limits.speed.mean())

    def cloud(self, scan_row: int) -> PointCloud:
        """Return the points of a scan in the odometry frame, as the local costmap takes them."""
        return self.planner.cloud(self.recording.scan(scan_row))

    def at(self, cycle: ReplayedCycle) -> CycleMoment:
        """Return what the planner saw and said in a cycle, of this replay or with other values."""
        scan_points = self.cloud(cycle.scan).points[:, :2]
        lookahead = PLAN_AHEAD_M * self.robot.world_scale
        return self.planner.moment(cycle, scan_points, lookahead)

    def ahead(self, cycle: Asked, settings: Settings, cycle_count: int) -> Ahead:
        """Return how the robot would drive on from a cycle with other parameters.

        Raises:
            ApplrError: The parameters contradict each other.
        """
        return self.planner.ahead(cycle, settings, cycle_count)


def replay_of(
    recording: Recording, planner: Optional[RerunPlanner] = None, watch: Watch = iter
) -> Replay:
    """Replay all cycles of a drive.

    Args:
        recording: The drive.
        planner: The robot's planner, which has answered nothing yet; by default a new one.
        watch: Shows the progress of a loop, as tqdm does.

    Raises:
        ApplrError: No command has a plan, a scan and odometry.
    """
    if planner is None:
        planner = RerunPlanner(recording.robot)
    history = _history(recording, planner.start_settings)
    search = _Search(recording, planner)
    clearing_times = [decision.time for decision in recording.drive.decisions if decision.cleared]
    left_out: Counter[str] = Counter()
    cycles = []

    # Each cycle continues from the map and the memory of the one before.
    settings = planner.start_settings
    map_before = planner.first_map(settings)
    memory = planner.first_memory
    for command_row in watch(range(len(recording.planned))):
        command_time = float(recording.planned.time[command_row])
        if history.at(command_time) is not settings:
            earlier_settings = settings
            settings = history.at(command_time)
            map_before = planner.reconfigured(map_before, earlier_settings, settings)
        odometry_row = recording.odometry.latest(command_time)
        scan_row = recording.scans.latest(command_time)
        plan = _plan(recording, command_time)
        if plan is None:
            left_out[WITHOUT_PLAN] += 1
            continue
        if odometry_row < 0 or scan_row < 0:
            left_out[TOO_EARLY] += 1
            continue
        pose, twist = recording.measured(odometry_row)
        v, w = recording.planned.twist[command_row].tolist()
        first_guess = ReplayedCycle(
            at=command_time,
            command=(v, w),
            pose=pose,
            twist=twist,
            plan=plan,
            map=map_before,
            memory=memory,
            is_new=False,
            settings=settings,
            scan=scan_row,
        )
        may_be_cleared = bool(clearing_times) and clearing_times[0] <= command_time
        cycle, memory = search.reproduced(first_guess, odometry_row, may_be_cleared)
        map_before = cycle.map
        cycles.append(cycle)
        # A call that no cycle shows within CLEARED_S had failed.
        is_over = may_be_cleared and clearing_times[0] <= command_time - CLEARED_S
        if cycle.is_cleared or is_over:
            clearing_times.pop(0)
    if not cycles:
        raise ApplrError(
            f"{recording.drive.name}: no command has a plan, a scan and odometry: "
            "record the drive from its beginning"
        )
    return Replay(recording, planner, history, cycles, left_out)


def _history(recording: Recording, start_settings: Settings) -> History:
    """Return the parameters in force from each change on."""
    settings = start_settings
    times = [-math.inf]
    all_settings = [settings]
    for change_time, server, values in changes_of(recording.drive, recording.robot):
        settings = settings.with_(*settings.differences({server: values}))
        times.append(change_time)
        all_settings.append(settings)
    return History(times, all_settings)


def _plan(recording: Recording, at: float) -> Optional[np.ndarray]:
    """Return the plan of the cycle at a time, or None if there was no plan.

    DWAPlannerROS publishes an empty plan if it finds no command. Its plan is then the one before.
    """
    plans = recording.plans
    plan_row = plans.latest(at + SAME_CYCLE_S)
    if plan_row < 0 or plans.time[plan_row] < at - SAME_CYCLE_S:
        return None
    for plan_path in plans.path[plan_row::-1]:
        if len(plan_path):
            return plan_path
    return None


def some(cycles: Sequence[ReplayedCycle], count: int, power: float = 1.0) -> List[ReplayedCycle]:
    """Return at most `count` cycles, only reproduced ones if there are any.

    With a power of 1 they are evenly spread; a larger one prefers early cycles.
    """
    reproduced = [cycle for cycle in cycles if cycle.reproduced]
    # A replay that reproduces nothing still shows what the planner may have weighed.
    preferred = reproduced or list(cycles)
    if not preferred:
        return []
    shares = np.linspace(0.0, 1.0, count) ** power
    rows = (shares * (len(preferred) - 1)).round().astype(int)
    return [preferred[row] for row in np.unique(rows)]


class _Search:
    """Looks for what a cycle was given, by the command that was recorded of it."""

    def __init__(self, recording: Recording, planner: RerunPlanner):
        self._recording = recording
        self._planner = planner
        self._cycle_count = 0
        self._run_count = 0

    def reproduced(
        self, first_guess: ReplayedCycle, odometry_row: int, may_be_cleared: bool
    ) -> Tuple[ReplayedCycle, Memory]:
        """Return a cycle with the first choice that reproduces it, and the memory after it.

        Without such a choice it is the first one, with the least error of all of them.
        """
        choices = self._choices(first_guess, odometry_row, may_be_cleared)
        self._cycle_count += 1
        if self._run_count > max(HEAD_START, PATIENCE * self._cycle_count):
            choices = islice(choices, LIKELY)
        first_choice = next(choices)
        least_error = np.inf
        for choice in chain([first_choice], choices):
            self._run_count += 1
            result = self._planner.run(choice)
            error = _difference(result.command, choice.command)
            if error < EQUAL:
                return replace(choice, error=error), result.memory
            least_error = min(least_error, error)
        # The robot did what was recorded, whatever the replay would have done.
        memory = self._planner.followed(first_choice, first_choice.command)
        return replace(first_choice, error=least_error), memory

    def _choices(
        self, first_guess: ReplayedCycle, odometry_row: int, may_be_cleared: bool
    ) -> Iterator[ReplayedCycle]:
        """Yield the choices of a cycle's messages and map, the likely ones first and each once."""
        # Whether the plan was new is tried only if that makes a difference.
        is_new_choices = [False]
        if self._planner.clears_flags(first_guess):
            is_new_choices.append(True)
        paths = self._paths(first_guess)
        for map_shown, is_cleared in self._maps(first_guess, odometry_row, may_be_cleared):
            states = self._states(odometry_row)
            for (pose, twist), is_new, plan_path in product(states, is_new_choices, paths):
                yield replace(
                    first_guess,
                    pose=pose,
                    twist=twist,
                    map=map_shown,
                    plan=plan_path,
                    is_new=is_new,
                    is_cleared=is_cleared,
                )

    def _states(self, odometry_row: int) -> Iterator[Tuple[Pose, Twist]]:
        """Yield the poses and velocities that the planner may have been given, each pair once."""
        known_states = set()
        for twist_lag, pose_shift in product(LAGS, POSE_SHIFTS):
            twist_row = odometry_row - twist_lag
            pose_row = twist_row + pose_shift
            if min(twist_row, pose_row) < 0:
                continue
            if max(twist_row, pose_row) >= len(self._recording.odometry):
                continue
            pose, _ = self._recording.measured(pose_row)
            _, twist = self._recording.measured(twist_row)
            # A robot that stands repeats its messages.
            if (pose, twist) not in known_states:
                known_states.add((pose, twist))
                yield pose, twist

    def _paths(self, first_guess: ReplayedCycle) -> List[np.ndarray]:
        """Return the plan of a cycle, and the one before it if either may have been followed."""
        plans = self._recording.plans
        plan_row = plans.latest(first_guess.at)
        if plan_row > 0 and plans.time[plan_row - 1] == plans.time[plan_row] == first_guess.at:
            return [first_guess.plan, plans.path[plan_row - 1]]
        return [first_guess.plan]

    def _maps(
        self, first_guess: ReplayedCycle, odometry_row: int, may_be_cleared: bool
    ) -> Iterator[Tuple[MapSnapshot, bool]]:
        """Yield the maps that the planner may have seen, each once, and whether they were cleared.

        If the map may have been cleared since the cycle before, the cleared one comes first.
        """
        settings = first_guess.settings
        maps_before = [(first_guess.map, False)]
        if may_be_cleared:
            maps_before.insert(0, (self._planner.cleared(first_guess.map, settings), True))
        known_maps: List[MapSnapshot] = []
        for (map_before, is_cleared), (scan_age, odometry_age) in product(maps_before, UPDATES):
            if first_guess.scan < (scan_age or 0) or odometry_row < odometry_age:
                continue
            map_shown = map_before
            if scan_age is not None:
                robot_pose, _ = self._recording.measured(odometry_row - odometry_age)
                scan = self._recording.scan(first_guess.scan - scan_age)
                cloud = self._planner.cloud(scan)
                map_shown = self._planner.updated(map_before, settings, robot_pose, cloud)
            # Where the robot stands, one update is like the other.
            if not any(_are_equal(map_shown, known_map) for known_map in known_maps):
                known_maps.append(map_shown)
                yield map_shown, is_cleared


def _are_equal(first: MapSnapshot, second: MapSnapshot) -> bool:
    """Return whether two maps have the same place and cells."""
    return all(map(np.array_equal, first, second))


def _difference(command: Twist, other: Twist) -> float:
    """Return the difference of two commands [m/s + rad/s]."""
    v, w = command
    other_v, other_w = other
    return abs(v - other_v) + abs(w - other_w)
