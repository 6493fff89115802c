"""Recorder: collects the rows of a drive while it happens, and returns them as a Drive."""

from typing import Any, Dict, List, Mapping, Optional

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.scan import LaserScan
from applr_ros1.drives.drive import (
    Changes,
    Clearances,
    Commands,
    Decision,
    Drive,
    Goal,
    Motion,
    Plans,
    Refusals,
    Scans,
    SentGoal,
    Verdicts,
)
from applr_ros1.monitor.monitor import Verdict
from applr_ros1.monitor.motion import Twist
from worlds import World


class Table:
    """Growing table of numbers, whose rows can be read as an array at any time.

    Args:
        width: Number of columns.
    """

    def __init__(self, width: int):
        self._rows = np.empty((256, width))
        self._count = 0

    def append(self, *numbers: float) -> None:
        """Add a row."""
        # Doubling keeps the mean cost of a row constant.
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = numbers
        self._count += 1

    @property
    def rows(self) -> np.ndarray:
        """Rows so far (n, width), as a view."""
        return self._rows[: self._count]


class Log:
    """Growing list of values with the times at which they came."""

    def __init__(self) -> None:
        self._times: List[float] = []
        self._values: List[Any] = []

    def append(self, time: float, value: Any) -> None:
        """Add a value that came at a time [s]."""
        self._times.append(time)
        self._values.append(value)

    @property
    def times(self) -> np.ndarray:
        """Times so far (n,) [s]."""
        return np.array(self._times, np.float64)

    @property
    def values(self) -> List[Any]:
        """Values so far, as a copy."""
        # The log grows on, but not the drives that were made of it.
        return list(self._values)


class Recorder:
    """Collects the rows of one drive, with times in seconds since the drive's beginning.

    True motion, clearances, contacts, goals and decisions are always kept: an Outcome is made of
    them. So is odometry that the caller appends.

    Args:
        world: World of the drive.
        everything: Whether `drive` has scans, plans, refusals, commands, verdicts and changes of
            parameters, too. The caller appends them.
    """

    def __init__(self, world: Optional[World] = None, everything: bool = False):
        self.everything = everything
        self._world = world
        # Rows that an Outcome needs
        self._truth = Table(6)  # time, x, y, yaw, v, w
        self._clearances = Table(2)  # time, smallest range
        self._observed = Table(2)  # time, smallest range
        self._contacts: List[float] = []
        self._odometry = Table(6)  # time, x, y, yaw, v, w
        # Rows for a diagnosis or a bag
        self._scans = Log()
        self._routes = Log()
        self._plans = Log()
        self._refusals = Log()  # {critic: number}
        self._planned = Table(3)  # time, v, w
        self._commands = Table(3)  # time, v, w
        self._verdicts = Log()
        self._servers = Log()  # names of the servers whose parameters changed
        self._values = Log()
        self._recoveries: List[float] = []
        self.decisions: List[Decision] = []
        self.ends: List[Decision] = []
        self.sent: List[SentGoal] = []
        self.goals: List[Goal] = []

    # -- rows that are always kept -----------------------------------------------------------------
    def moved(self, time: float, pose: Pose, twist: Twist) -> None:
        """Add the robot's true motion."""
        self._truth.append(time, *pose, *twist)

    def measured(self, time: float, nearest: float) -> None:
        """Add the smallest range of a scan [m]."""
        self._clearances.append(time, nearest)

    def observed(self, time: float, nearest: float) -> None:
        """Add the smallest range [m] of a scan that the method sees."""
        self._observed.append(time, nearest)

    def touched(self, time: float) -> None:
        """Add a contact."""
        self._contacts.append(time)

    def localised(self, time: float, pose: Pose, twist: Twist) -> None:
        """Add the robot's motion by odometry."""
        self._odometry.append(time, *pose, *twist)

    # -- rows that are kept on request -------------------------------------------------------------
    def scanned(self, time: float, scan: LaserScan) -> None:
        """Add a laser scan."""
        self._scans.append(time, scan)

    def routed(self, time: float, path: np.ndarray) -> None:
        """Add a plan (k, 3) of the global planner."""
        self._routes.append(time, path)

    def refused(self, time: float, critics: Dict[str, int]) -> None:
        """Add a cycle of the local planner.

        critics: number of velocities that each critic rejected if none was valid, else {}.
        """
        self._refusals.append(time, critics)

    def planned(self, time: float, command: Twist, path: np.ndarray) -> None:
        """Add a command of the local planner, and the plan (k, 3) that it followed."""
        self._planned.append(time, *command)
        self._plans.append(time, path)

    def commanded(self, time: float, command: Twist) -> None:
        """Add a command to the base."""
        self._commands.append(time, *command)

    def judged(self, time: float, verdict: Verdict) -> None:
        """Add a verdict of the collision monitor."""
        self._verdicts.append(time, verdict)

    def changed(self, time: float, server: str, values: Mapping[str, Any]) -> None:
        """Add parameters {name: value} of a server that are now in force."""
        self._servers.append(time, server)
        self._values.append(time, dict(values))

    def recovered(self, time: float) -> None:
        """Add the beginning of a recovery behaviour."""
        self._recoveries.append(time)

    # -- the drive ---------------------------------------------------------------------------------
    @property
    def drive(self) -> Drive:
        """Drive so far, with all columns that are kept."""
        drive = self.course
        if self.everything:
            self._add_details(drive)
        return drive

    @property
    def course(self) -> Drive:
        """Drive so far in the columns of which an Outcome is made.

        They are views where they can be: a training asks for them at each decision.
        """
        return Drive(
            name=self._world.name if self._world is not None else "",
            truth=_motion(self._truth.rows),
            # A column without rows was not recorded.
            odometry=_motion(self._odometry.rows) or None,
            clearances=_clearances(self._clearances.rows),
            observed=_clearances(self._observed.rows) or None,
            decisions=self.decisions,
            ends=self.ends,
            sent=self.sent,
            goals=self.goals,
            contacts=np.array(self._contacts),
            world=self._world,
        )

    def _add_details(self, drive: Drive) -> None:
        """Add the columns that are kept on request."""
        drive.planned = _commands(self._planned.rows)
        drive.commands = _commands(self._commands.rows)
        drive.routes = Plans(self._routes.times, self._routes.values)
        drive.plans = Plans(self._plans.times, self._plans.values)
        drive.refusals = Refusals(self._refusals.times, self._refusals.values)
        drive.scans = _scans(self._scans)
        drive.verdicts = Verdicts(self._verdicts.times, action=[], reason=[], blocked=[])
        for verdict in self._verdicts.values:
            drive.verdicts.action.append(verdict.action)
            drive.verdicts.reason.append(verdict.reason)
            drive.verdicts.blocked.append(verdict.blocked)
        drive.changes = Changes(self._values.times, self._servers.values, self._values.values)
        drive.recoveries = np.array(self._recoveries)


def _motion(rows: np.ndarray) -> Motion:
    """Return rows of time, x, y, yaw, v, w as a Motion."""
    times = rows[:, 0]
    poses = rows[:, 1:4]
    twists = rows[:, 4:6]
    # A simulator's rows hold for the time at which they come.
    return Motion(time=times, stamp=times, pose=poses, twist=twists)


def _commands(rows: np.ndarray) -> Commands:
    """Return rows of time, v, w as columns."""
    return Commands(time=rows[:, 0], twist=rows[:, 1:])


def _clearances(rows: np.ndarray) -> Clearances:
    """Return rows of time and smallest range as columns."""
    return Clearances(time=rows[:, 0], nearest=rows[:, 1])


def _scans(log: Log) -> Scans:
    """Return laser scans as columns."""
    fans = []
    ranges = []
    for scan in log.values:
        fans.append((scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max))
        ranges.append(scan.ranges)
    return Scans(log.times, log.times, np.array(fans).reshape(-1, 4), ranges)
