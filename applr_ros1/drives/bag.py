"""A drive as the messages of a bag: from rows that were unpacked, and to rows to be packed.

received.py and the writer of bags (training/bags) call it. It needs neither ROS nor rosbags.
"""

import math
from dataclasses import fields
from operator import attrgetter
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Sequence, Type

import numpy as np

from applr_ros1.drives.columns import (
    CODE_OF_END,
    COLUMNS,
    PREEMPTED,
    SECOND,
    Row,
    Stamp,
    column_of,
)
from applr_ros1.drives.drive import KIND_OF_COLUMN, Drive, Goal, Rows
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import ACTIVE

# move_base's action, and those of move_base_flex, the one first that runs the others
ACTIONS = ("", "move_base", "exe_path", "recovery", "get_path")
GLOBAL_PLANNER = "NavfnROS"  # name of the global planner under which routes are written


class UnpackedRow(NamedTuple):
    """Row of a message, and when the message came, since the first one [s]."""

    time: float
    values: Row


class PackedRow(NamedTuple):
    """Row that becomes a message.

    Attributes:
        time: Time of the drive [s].
        key: Key of its topic in COLUMNS.
        values: The row.
        part: Planner or server that `*` stands for in the topic; "" if there is none.
        number: Number of the row in its column.
    """

    time: float
    key: str
    values: Row
    part: str = ""
    number: int = 0


# -- from messages ---------------------------------------------------------------------------------
def drive_of(unpacked: Mapping[str, Sequence[UnpackedRow]], begin_time: int, robot: Robot) -> Drive:
    """Return the drive in the messages of a bag.

    Args:
        unpacked: Rows of each column of Drive, in order of recording.
        begin_time: Time of the first message by the robot's clock [ns].
        robot: Robot that drove.
    """
    by_planner = _by_planner(unpacked.get("plans", ()))
    drive = Drive(planners=sorted(by_planner), goals=_goals(unpacked.get("goals", ())))
    for column, kind in KIND_OF_COLUMN.items():
        if column not in COLUMNS:
            continue
        rows = unpacked.get(column, ())
        if column == "plans":
            # If several planners are recorded, the robot followed the plans of its own.
            rows = by_planner.get(robot.local_planner, ())
        elif column == "routes":
            rows = _last_of_each_stamp(rows)
        values_of_rows = [_in_seconds(row, begin_time) for row in rows]
        if not issubclass(kind, Rows):
            setattr(drive, column, [kind(**values) for values in values_of_rows])
            continue
        drive.frames[column] = _frames(values_of_rows)
        if values_of_rows:
            setattr(drive, column, _rows(kind, values_of_rows))
    # Events that have a time alone
    for column in ("contacts", "recoveries"):
        times = [row.time for row in unpacked.get(column, ())]
        setattr(drive, column, np.array(times, np.float64))
    if drive.frames["odometry"]:
        drive.frame = drive.frames["odometry"][0]
    # A plan without a frame is in that of the others, or else of the odometry.
    for column in ("plans", "routes"):
        frames = drive.frames[column]
        if "" in frames:
            drive.frames[column] = [name for name in frames if name] or [drive.frame]
    if "source" in unpacked:
        drive.source = unpacked["source"][-1].values["source"]
    return drive


def _in_seconds(row: UnpackedRow, begin_time: int) -> Row:
    """Return the values of a row, with its time and all stamps since the begin [s]."""
    values = {"time": row.time}
    for name, value in row.values.items():
        if isinstance(value, Stamp):
            # What has no stamp is as old as its message.
            values[name] = (value - begin_time) / SECOND if value else row.time
        else:
            values[name] = value
    return values


def _rows(kind: Type[Rows], values_of_rows: Sequence[Row]) -> Rows:
    """Return rows as an object of their class."""
    columns: Dict[str, Any] = {}
    for column in fields(kind):
        entries = [values[column.name] for values in values_of_rows]
        columns[column.name] = entries
        if column.type is np.ndarray:
            columns[column.name] = np.array(entries, np.float64)
    return kind(**columns)


def _frames(values_of_rows: Sequence[Row]) -> List[str]:
    """Return the frames of rows that have one, in order of appearance."""
    frames = [values["frame"] for values in values_of_rows if "frame" in values]
    return list(dict.fromkeys(frames))


def _by_planner(rows: Sequence[UnpackedRow]) -> Dict[str, List[UnpackedRow]]:
    """Return plans by the name of their planner."""
    by_planner: Dict[str, List[UnpackedRow]] = {}
    for row in rows:
        by_planner.setdefault(row.values["planner"], []).append(row)
    return by_planner


def _last_of_each_stamp(routes: Sequence[UnpackedRow]) -> List[UnpackedRow]:
    """Return the complete plans of the global planner.

    Navfn publishes each plan twice, first without the goal's pose (navfn_ros.cpp, makePlan). Both
    have one stamp; the second is the one that the local planner gets.
    """
    complete_plans = []
    for index, row in enumerate(routes):
        is_last = index + 1 == len(routes)
        if is_last or routes[index + 1].values["stamp"] != row.values["stamp"]:
            complete_plans.append(row)
    return complete_plans


def running_goal(status: Row, running_ids: Dict[str, str]) -> str:
    """Return the id of the goal that move_base pursues after a status, or "".

    Args:
        status: Row of the status.
        running_ids: {action: id} of the statuses before it, which is updated. move_base_flex has
            several actions, which it runs for one of them, or for its clients.
    """
    running_ids[status.get("action", "")] = status["running"]
    for action in ACTIONS:
        if running_ids.get(action):
            return running_ids[action]
    return ""


def _goals(rows: Sequence[UnpackedRow]) -> List[Goal]:
    """Return the goals that move_base pursued, by the status of its action, with their results."""
    pursued: List[Goal] = []
    previous_id = ""
    running_ids: Dict[str, str] = {}
    results_by_goal = {}
    for row in rows:
        if "status" in row.values:
            results_by_goal[row.values["id"]] = row
            continue
        # The goal was pursued until this message.
        if previous_id:
            pursued[-1] = pursued[-1]._replace(end=row.time)
        running_id = running_goal(row.values, running_ids)
        if running_id and running_id != previous_id:
            pursued.append(Goal(running_id, row.time, row.time))
        previous_id = running_id
    goals = []
    for goal in pursued:
        result = results_by_goal.get(goal.id)
        if result is not None:
            end_time = min(goal.end, result.time)
            goal = goal._replace(end=end_time, status=result.values["status"])
        goals.append(goal)
    return goals


# -- to messages -----------------------------------------------------------------------------------
def rows_of(drive: Drive, robot: Robot) -> List[PackedRow]:
    """Return the rows of a drive that a bag has, those of one time in the order of COLUMNS."""
    rows = []
    for key in COLUMNS:
        for number, values in enumerate(_values_of(drive, key)):
            part = _part(drive, key, values, robot)
            rows.append(PackedRow(float(values["time"]), key, values, part, number))
        if key == "results":
            # A goal that has ended stays in the status for some seconds.
            for values in _values_of(drive, key):
                rows.append(PackedRow(values["time"], "goals", values))
    return sorted(rows, key=attrgetter("time"))


def _part(drive: Drive, key: str, values: Row, robot: Robot) -> str:
    """Return the planner or server that `*` stands for in a row's topic, or ""."""
    if key == "plans":
        return drive.planners[0] if drive.planners else robot.local_planner
    if key == "routes":
        return GLOBAL_PLANNER
    return str(values.get(COLUMNS[key].part, ""))


def _values_of(drive: Drive, key: str) -> Iterator[Row]:
    """Yield the values of the rows that are written on a topic of COLUMNS, with their times [s]."""
    column = getattr(drive, column_of(key))
    if key == "source":
        if column:
            yield {"time": 0.0, "source": column}
    elif key == "goals":
        for goal in drive.goals:
            yield {"time": goal.begin, "id": goal.id, "code": ACTIVE}
    elif key == "results":
        for goal in drive.goals:
            if math.isfinite(goal.end):
                end_code = CODE_OF_END.get(goal.status, PREEMPTED)
                yield {"time": goal.end, "id": goal.id, "code": end_code}
    elif key == "routes" and drive.plans is not None:
        # Beside the followed plans nobody reads them, and they are long.
        return
    elif isinstance(column, Rows):
        for values in _rows_as_values(column):
            # Frames that do not move have a topic of their own.
            if values.get("is_static", False) == (key == "static_transforms"):
                yield values
    elif isinstance(column, np.ndarray):
        for time in column.tolist():
            yield {"time": time}
    elif column is not None:
        for event in column:
            yield event._asdict()


def _rows_as_values(rows: Rows) -> Iterator[Row]:
    """Yield the rows of a column, each by the names of its fields."""
    names = [column.name for column in fields(rows)]
    for row in range(len(rows)):
        yield {name: getattr(rows, name)[row] for name in names}
