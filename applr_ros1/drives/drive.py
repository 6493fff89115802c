"""Drive: one drive of a robot in columns, whether it was simulated or recorded in a bag.

Simulated drives, the demo and the reader of bags write drives. Datasets, demonstrations, the
replay, pages and reports read them. All times are in seconds since the drive's beginning.
"""

import io
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Dict, List, NamedTuple, Optional, Tuple, Type, TypeVar, get_type_hints

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array32
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.paths import step_lengths
from applr_ros1.common.scan import LaserScan, distances_of
from applr_ros1.monitor.monitor import STOP
from applr_ros1.policy.decision import Seen
from applr_ros1.robots.robot import Laser
from worlds import World

SelfRows = TypeVar("SelfRows", bound="Rows")
Needed = TypeVar("Needed")
WIDTH = "width"  # key of a field's metadata: numbers in a row of its array
# How the planner ended a goal
REACHED = "reached"
ABORTED = "aborted"
# How a rule of the trial ended it
FLIPPED = "flipped"
TOUCHED = "touched"
STALLED = "stalled"
TIMED_OUT = "timed out"
# A person ended it, or replaced it by another goal.
CANCELLED = "cancelled"


class DriveError(ApplrError):
    """Error of a drive that lacks a column."""


@dataclass
class Rows:
    """Rows of a drive in order of time. Each field has one entry per row.

    Attributes:
        time: (n,) times at which the rows came [s].
    """

    time: np.ndarray

    def __len__(self) -> int:
        return len(self.time)

    def latest(self, time: float) -> int:
        """Return the index of the latest row until `time` [s], or -1."""
        next_row = int(np.searchsorted(self.time, time, side="right"))
        return next_row - 1

    def between(self: SelfRows, begin: float, end: float) -> SelfRows:
        """Return the rows with begin <= time <= end [s]."""
        first_row = int(np.searchsorted(self.time, begin, side="left"))
        end_row = int(np.searchsorted(self.time, end, side="right"))
        return self.part(slice(first_row, end_row))

    def part(self: SelfRows, rows: slice) -> SelfRows:
        """Return a slice of the rows."""
        # Arrays give views, and lists give short copies, so that a window of a long drive is cheap.
        columns = {}
        for column in fields(self):
            columns[column.name] = getattr(self, column.name)[rows]
        return type(self)(**columns)


def _no_values() -> np.ndarray:
    return np.empty(0)


@dataclass
class Motion(Rows):
    """Poses and velocities of the robot.

    Attributes:
        stamp: (n,) times for which the rows hold [s].
        pose: (n, 3) x, y [m], yaw [rad].
        twist: (n, 2) v [m/s], w [rad/s].
        sideways: (n,) velocity to the left [m/s]; 0 unless it is given.
    """

    stamp: np.ndarray
    pose: np.ndarray = field(metadata={WIDTH: 3})
    twist: np.ndarray = field(metadata={WIDTH: 2})
    sideways: np.ndarray = field(default_factory=_no_values)

    def __post_init__(self) -> None:
        if not len(self.sideways):
            self.sideways = np.zeros(len(self.time))

    def pose_at(self, stamp: float) -> Pose:
        """Return the pose (x, y, yaw) [m, m, rad] at a time [s], between the poses around it."""
        x, y, yaw = self.poses_at(stamp).tolist()
        return x, y, yaw

    def poses_at(self, stamps: Any) -> np.ndarray:
        """Return the poses (n, 3) at times (n,) [s], between the poses around them."""
        x = np.interp(stamps, self.stamp, self.pose[:, 0])
        y = np.interp(stamps, self.stamp, self.pose[:, 1])
        yaw = np.interp(stamps, self.stamp, self._yaws)
        return np.stack([x, y, yaw], axis=-1)

    @cached_property
    def _yaws(self) -> np.ndarray:
        """Yaw angles without jumps by a full turn [rad]."""
        return np.unwrap(self.pose[:, 2])

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(step_lengths(self.pose[:, :2]).sum())


@dataclass
class Commands(Rows):
    """Velocity commands.

    Attributes:
        twist: (n, 2) v [m/s], w [rad/s].
        sideways: (n,) velocity to the left [m/s]; 0 unless it is given.
    """

    twist: np.ndarray = field(metadata={WIDTH: 2})
    sideways: np.ndarray = field(default_factory=_no_values)

    def __post_init__(self) -> None:
        if not len(self.sideways):
            self.sideways = np.zeros(len(self.time))


Moving = TypeVar("Moving", Motion, Commands)


def with_full_speed(rows: Moving) -> Moving:
    """Return motion or commands whose v is the speed to all sides; negative if it is backwards.

    A planner is given the speed ahead alone: this is for whoever asks whether a base moves.
    """
    if not rows.sideways.any():
        return rows
    v, w = rows.twist.T
    speed = np.hypot(v, rows.sideways)
    signed_speed = np.where(v < -np.abs(rows.sideways), -speed, speed)
    return replace(rows, twist=np.column_stack([signed_speed, w]))


@dataclass
class Scans(Rows):
    """Laser scans.

    Attributes:
        stamp: (n,) times of the scans [s].
        fan: (n, 4) angle of the first range, angle between ranges [rad], minimum and maximum
            range [m].
        ranges: Ranges (m,) float32 [m] of each scan (LaserScan.ranges).
    """

    stamp: np.ndarray
    fan: np.ndarray = field(metadata={WIDTH: 4})
    ranges: List[np.ndarray]

    def distances(self, row: int) -> Array32:
        """Return what the beams of a scan have shown (m,) [m] (LaserScan.distances)."""
        _, _, range_min, range_max = self.fan[row]
        return distances_of(self.ranges[row], range_min, range_max)

    def scan(self, row: int, stamp: float, sensor_pose: Pose, laser: Laser) -> LaserScan:
        """Return a scan for planner and monitor.

        Args:
            row: Row of the scan.
            stamp: Stamp that it gets [s].
            sensor_pose: Pose (x, y, yaw) of the laser at the scan's own stamp.
            laser: Laser of the robot.
        """
        first_angle, increment, range_min, range_max = self.fan[row].tolist()
        return LaserScan(
            stamp=stamp,
            angle_min=first_angle,
            angle_increment=increment,
            range_min=range_min,
            range_max=range_max,
            ranges=self.ranges[row],
            sensor_pose=sensor_pose,
            sensor_height=laser.height,
            no_return=laser.no_return,
        )


@dataclass
class Clearances(Rows):
    """Distances to the nearest obstacle.

    Attributes:
        nearest: (n,) smallest range of the laser [m]; inf without a return.
    """

    nearest: np.ndarray


@dataclass
class Plans(Rows):
    """Plans of the global planner, or the parts of them that the local planner followed.

    Attributes:
        path: Poses (k, 3) x, y [m], yaw [rad] of each plan; (0, 3) for an empty plan.
    """

    path: List[np.ndarray]

    @property
    def ends(self) -> Tuple[List[float], List[Pose]]:
        """Times [s] and last poses of the plans that have poses."""
        times = []
        ends = []
        for time, plan_path in zip(self.time.tolist(), self.path):
            if len(plan_path):
                x, y, yaw = plan_path[-1].tolist()
                times.append(time)
                ends.append((x, y, yaw))
        return times, ends


@dataclass
class Transforms(Rows):
    """Places of frames in others (tf).

    Attributes:
        stamp: (n,) times for which the rows hold [s].
        parent: Frame in which each row places another.
        child: The frame that it places.
        place: (n, 7) x, y, z [m], and the quaternion x, y, z, w of its rotation.
        is_static: Whether each row holds at all times.
    """

    stamp: np.ndarray
    parent: List[str]
    child: List[str]
    place: np.ndarray = field(metadata={WIDTH: 7})
    is_static: List[bool]


@dataclass
class Refusals(Rows):
    """Control cycles of the local planner, and what it rejected in them.

    Attributes:
        critics: Number of velocities that each critic rejected in a cycle without a valid one; else
            {}.
    """

    critics: List[Dict[str, int]]


@dataclass
class Verdicts(Rows):
    """Verdicts of the collision monitor.

    Attributes:
        action: PASS, BRAKE, SLOW or STOP of each (monitor/monitor.py).
        reason: One line that explains each change; "" if the command passed.
    """

    action: List[str]
    reason: List[str]

    @property
    def blocked(self) -> List[bool]:
        """True for each verdict with which the monitor stopped the base."""
        return [action == STOP for action in self.action]


@dataclass
class Changes(Rows):
    """Changes of parameters, and those in force at the beginning, in a row at time 0.

    Attributes:
        server: Names of the reconfigure servers.
        values: {name: value} of each change.
    """

    server: List[str]
    values: List[Dict[str, Any]]


class Decision(NamedTuple):
    """Decision of a method (msg/Decision.msg), or its observation at the end of a course.

    Attributes:
        goal: Identifier of the goal.
        time: Time of the decision [s].
        scan_time: Time of the scan on which the decision is based [s].
        before: Parameters {name: value} in force before the decision.
        after: Parameters after the decision; empty at the end of a course.
        seen: Inputs of the decision; None if they were not recorded.
        cleared: Whether both costmaps were cleared before the decision took effect.
    """

    goal: str
    time: float
    scan_time: float
    before: Dict[str, float]
    after: Dict[str, float]
    seen: Optional[Seen]
    cleared: bool = False


class Goal(NamedTuple):
    """Goal of a drive.

    Attributes:
        id: Identifier.
        begin: Time of its sending [s].
        end: Time of its end, or of the drive's [s].
        status: REACHED, ABORTED, FLIPPED, TOUCHED, STALLED, TIMED_OUT or CANCELLED; "" if it is
            still pursued.
        reason: Why it ended, in words.
    """

    id: str
    begin: float
    end: float
    status: str = ""
    reason: str = ""

    @property
    def has_ended(self) -> bool:
        """True if the planner reached the goal or gave up."""
        return self.status in (REACHED, ABORTED)


class SentGoal(NamedTuple):
    """Goal as it was sent: time [s], pose (x, y, yaw) [m, m, rad], and its frame."""

    time: float
    pose: Tuple[float, float, float]
    frame: str


@dataclass
class Drive:
    """One drive. A column that was not recorded is None, and lists of events are empty.

    Attributes:
        name: Name of the drive for people: its file, or its world.
        recorded_at: Time at which it begins by the clock of its recorder [s].
        frame: Frame of odometry and plans.
        frames: Frames of a column's recorded messages, in order of appearance.
        planners: Names of the local planners whose plans were recorded.
        truth: True motion in the frame of the world.
        odometry: Motion by odometry.
        transforms: Places of frames in others.
        scans: Laser scans.
        clearances: Distances to the nearest obstacle.
        observed: Distances to the nearest obstacle in the scans that the method saw, if it had
            scans of its own.
        routes: Plans of the global planner, from the robot to the goal.
        plans: Plans that were followed: the part of a route that the local planner keeps.
        refusals: What the local planner rejected.
        planned: Commands of the planner, before a collision monitor.
        commands: Commands at the base.
        verdicts: Verdicts of the collision monitor.
        changes: Parameters in force.
        decisions: Decisions of the method.
        ends: Observations of the method at the ends of courses.
        sent: Goals as they were sent.
        goals: Goals that were pursued.
        contacts: (k,) times at which the robot touched something [s].
        recoveries: (k,) times at which recovery behaviours began [s].
        world: World in which the robot drove, if it is known.
        source: Who drove, and where, as told by the recorder.
        notes: Sentences for people about a recording that differs from what is expected.
        topics: {topic: its key in COLUMNS} of what was recorded; {} for a simulated drive.
    """

    name: str = ""
    recorded_at: float = 0.0
    frame: str = "odom"
    frames: Dict[str, List[str]] = field(default_factory=dict)
    planners: List[str] = field(default_factory=list)
    # Where the robot was, and what it measured
    truth: Optional[Motion] = None
    odometry: Optional[Motion] = None
    transforms: Optional[Transforms] = None
    scans: Optional[Scans] = None
    clearances: Optional[Clearances] = None
    observed: Optional[Clearances] = None
    # What the planner, the monitor and reconfigure clients did
    routes: Optional[Plans] = None
    plans: Optional[Plans] = None
    refusals: Optional[Refusals] = None
    planned: Optional[Commands] = None
    commands: Optional[Commands] = None
    verdicts: Optional[Verdicts] = None
    changes: Optional[Changes] = None
    # Events
    decisions: List[Decision] = field(default_factory=list)
    ends: List[Decision] = field(default_factory=list)
    sent: List[SentGoal] = field(default_factory=list)
    goals: List[Goal] = field(default_factory=list)
    contacts: np.ndarray = field(default_factory=lambda: np.empty(0))
    recoveries: np.ndarray = field(default_factory=lambda: np.empty(0))
    world: Optional[World] = None
    source: Dict[str, Any] = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)
    topics: Dict[str, str] = field(default_factory=dict)

    @property
    def end(self) -> float:
        """Time of the last scan, odometry or command [s]."""
        latest_time = 0.0
        for rows in (self.odometry, self.scans, self.planned, self.commands):
            if rows is not None and len(rows):
                latest_time = max(latest_time, float(rows.time[-1]))
        return latest_time

    def pack(self) -> bytes:
        """Return the driven path as npz.

        It has time, pose and twist in a row per control cycle, theta and decided per decision, the
        names of the parameters, and the times of contacts. Poses are true. A path is kept of many
        trials, for pictures: everything else is left out.
        """
        truth = self.require(Driven).truth
        columns = {
            "time": truth.time,
            "pose": truth.pose,
            "twist": truth.twist,
            "theta": [list(decision.after.values()) for decision in self.decisions],
            "decided": [decision.time for decision in self.decisions],
            "contacts": self.contacts,
        }
        # float32 halves the file, and pictures need no more.
        arrays: Dict[str, Any] = {}
        for column_name, column in columns.items():
            arrays[column_name] = np.asarray(column, np.float32)
        names: List[str] = []
        for decision in self.decisions[:1]:
            names += decision.after
        arrays["names"] = np.array(names, dtype=str)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        return buffer.getvalue()

    @classmethod
    def unpack(cls, packed: bytes) -> "Drive":
        """Return the drive of which `pack` returned the path."""
        with np.load(io.BytesIO(packed)) as arrays:
            times = arrays["time"]
            truth = Motion(times, times, arrays["pose"], arrays["twist"])
            thetas = arrays["theta"]
            decision_times = arrays["decided"]
            contact_times = arrays["contacts"]
            names = arrays["names"].tolist()
        decisions = []
        for decision_time, theta in zip(decision_times.tolist(), thetas.tolist()):
            decision = Decision(
                goal="",
                time=decision_time,
                scan_time=decision_time,
                before={},
                after=dict(zip(names, theta)),
                seen=None,
            )
            decisions.append(decision)
        return cls(truth=truth, decisions=decisions, contacts=contact_times)

    def require(self, needed: Type[Needed]) -> Needed:
        """Return the columns that a type such as Driven has as fields.

        Whoever needs columns declares such a type, a NamedTuple, and asks once. In its value they
        are there.

        Raises:
            DriveError: One of the columns is missing or empty.
        """
        columns = {}
        for column_name in get_type_hints(needed):
            column = getattr(self, column_name)
            # The length of rows is their truth value.
            if not column:
                raise DriveError(f"{self.name}: it has no {column_name}")
            columns[column_name] = column
        return needed(**columns)


class Driven(NamedTuple):
    """Columns of a drive whose true motion is known."""

    truth: Motion


class Measured(NamedTuple):
    """Columns of a drive with the sensors' measurements."""

    odometry: Motion
    scans: Scans


class DrivenToGoal(NamedTuple):
    """Columns of a drive to at least one goal, whose true motion is known."""

    truth: Motion
    goals: List[Goal]


def _kinds_of_columns() -> Dict[str, Any]:
    """Return {column: class of its rows or events} of the drive's columns that have one."""
    kinds = {}
    for column_name, declared in get_type_hints(Drive).items():
        # Optional[Motion] or List[Decision]
        for argument in getattr(declared, "__args__", ()):
            is_rows = isinstance(argument, type) and issubclass(argument, Rows)
            if is_rows or argument in (Decision, SentGoal):
                kinds[column_name] = argument
    return kinds


KIND_OF_COLUMN = _kinds_of_columns()
