"""Recorder: collects the rows of a drive while it happens, and returns them as a Drive."""

from dataclasses import MISSING, fields
from typing import Any, Dict, List, Optional, Type

import numpy as np

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.drives.drive import (
    KIND_OF_COLUMN,
    WIDTH,
    Decision,
    Drive,
    Goal,
    Rows,
    SentGoal,
)
from worlds import World

FIRST_ROWS = 256  # rows for which a log has room at first
# Columns of which an Outcome is made
ALWAYS = {"truth", "odometry", "clearances", "observed"}
UNKNOWN = {"transforms"}  # columns that only a robot with ROS has


class RowLog:
    """Growing rows of a column, which can be read at any time.

    Args:
        kind: Class of the rows, such as Motion.
    """

    def __init__(self, kind: Type[Rows]):
        self._kind = kind
        self._count = 0
        self._arrays: Dict[str, np.ndarray] = {}
        self._lists: Dict[str, List[Any]] = {}
        for column in fields(kind):
            if column.default_factory is not MISSING:
                continue  # Nobody records it here.
            if column.type is not np.ndarray:
                self._lists[column.name] = []
            elif WIDTH in column.metadata:
                self._arrays[column.name] = np.empty((FIRST_ROWS, column.metadata[WIDTH]))
            else:
                self._arrays[column.name] = np.empty(FIRST_ROWS)

    def append(self, **values: Any) -> None:
        """Add a row, with a value for each field of the class."""
        row = self._count
        if row == len(self._arrays["time"]):
            self._grow()
        for column_name, array in self._arrays.items():
            array[row] = values[column_name]
        for column_name, entries in self._lists.items():
            entries.append(values[column_name])
        self._count += 1

    def _grow(self) -> None:
        # Doubling keeps the mean cost of a row constant.
        for column_name, array in self._arrays.items():
            self._arrays[column_name] = np.concatenate([array, np.empty_like(array)])

    @property
    def rows(self) -> Any:
        """Rows so far. Its arrays are views, and the lists copies: the log grows on."""
        columns: Dict[str, Any] = {}
        for column_name, array in self._arrays.items():
            columns[column_name] = array[: self._count]
        for column_name, entries in self._lists.items():
            columns[column_name] = list(entries)
        return self._kind(**columns)


class Recorder:
    """Collects the rows of one drive, with times in seconds since the drive's beginning.

    True motion, clearances, contacts, goals and decisions are always kept: an Outcome is made of
    them. So is odometry that the caller appends.

    Args:
        world: World of the drive.
        everything: Whether `drive` has scans, plans, refusals, commands, verdicts and changes of
            parameters, too. The caller appends them.

    Attributes:
        frame: Frame of odometry and plans.
        contacts, recoveries: Times [s] of contacts, and of the beginnings of recovery behaviours.
        decisions, ends, sent, goals: As in Drive.
    """

    def __init__(self, world: Optional[World] = None, everything: bool = False):
        self.everything = everything
        self.frame = Drive.frame
        self._world = world
        self._logs: Dict[str, RowLog] = {}
        for column_name, kind in KIND_OF_COLUMN.items():
            if issubclass(kind, Rows):
                self._logs[column_name] = RowLog(kind)
        self.contacts: List[float] = []
        self.recoveries: List[float] = []
        self.decisions: List[Decision] = []
        self.ends: List[Decision] = []
        self.sent: List[SentGoal] = []
        self.goals: List[Goal] = []

    def add_row(self, column: str, time: float, **values: Any) -> None:
        """Add a row to a column of Drive, with the time [s] and the other fields of its class."""
        self._logs[column].append(time=time, **values)

    def moved(self, time: float, pose: Pose, twist: Twist) -> None:
        """Add the robot's true motion."""
        # A simulator's rows hold for the time at which they come.
        self.add_row("truth", time, stamp=time, pose=pose, twist=twist)

    def localised(self, time: float, pose: Pose, twist: Twist) -> None:
        """Add the robot's motion by odometry."""
        self.add_row("odometry", time, stamp=time, pose=pose, twist=twist)

    # -- the drive ---------------------------------------------------------------------------------
    @property
    def drive(self) -> Drive:
        """Drive so far, with all columns that are kept."""
        drive = self.course
        if self.everything:
            for column_name in self._logs.keys() - ALWAYS - UNKNOWN:
                setattr(drive, column_name, self._logs[column_name].rows)
            drive.recoveries = np.array(self.recoveries)
        return drive

    @property
    def course(self) -> Drive:
        """Drive so far in the columns of which an Outcome is made.

        They are views where they can be: a training asks for them at each decision.
        """
        return Drive(
            name=self._world.name if self._world is not None else "",
            frame=self.frame,
            truth=self._logs["truth"].rows,
            # A column without rows was not recorded.
            odometry=self._logs["odometry"].rows or None,
            clearances=self._logs["clearances"].rows,
            observed=self._logs["observed"].rows or None,
            decisions=self.decisions,
            ends=self.ends,
            sent=self.sent,
            goals=self.goals,
            contacts=np.array(self.contacts),
            world=self._world,
        )
