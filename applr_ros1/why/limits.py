"""Limits by which a drive is measured, from the values of any local planner."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Sequence, Set, Tuple

import numpy as np

from applr_ros1.drives.drive import Drive, Motion
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, SERVERS, namespace
from applr_ros1.planner.parameters.move_base_parameters import MOVE_BASE
from applr_ros1.planner.parameters.parameter import by_name
from applr_ros1.policy.parameter_space import unchecked_space
from applr_ros1.robots import Robot
from applr_ros1.why.events import DriveLimits

# Local planners that are replayed
REPLAYED = tuple(map(namespace, LOCAL_PLANNERS))
# Names of a limit in the local planners of ROS's navigation
SPEEDS = ("max_vel_x", "max_vel_trans", "max_trans_vel", "max_v", "max_linear_vel")
TURNS = ("max_vel_theta", "max_rot_vel", "max_w", "max_angular_vel")
TOLERANCE_M = 0.25  # distance from the goal of a planner that has none of its own [m]
# Control rate of a move_base that has none of its own [Hz]
USUAL_RATE: float = by_name(MOVE_BASE)["controller_frequency"].default
USUAL_TURN = 1.0  # top turn rate of a planner that has none [rad/s]


def limits_of(
    drive: Drive, odometry: Motion, robot: Robot, values_at_start: Mapping[str, Any]
) -> DriveLimits:
    """Return the limits of a drive, whichever local planner drove.

    Args:
        drive: The drive, with the changes of its parameters.
        odometry: Motion that is measured.
        robot: Robot that drove.
        values_at_start: The start_values of its local planner.
    """
    planner = planner_of(drive, robot)
    values: Dict[str, Any] = {}
    rate = 0.0
    # If another planner drove than the robot's, its parameters are another robot's.
    if planner == robot.local_planner:
        values.update(values_at_start)
        rate = float(robot.parameters().get("controller_frequency") or USUAL_RATE)
    rates = [(-np.inf, rate)]
    fastest_speed = float(np.abs(odometry.twist[:, 0]).max(initial=0.0))
    speed = np.empty(len(odometry))
    turn = np.empty(len(odometry))
    for change_time, server, changed_values in [(-np.inf, planner, {}), *changes_of(drive, robot)]:
        if server == planner:
            values.update(changed_values)
            is_later = odometry.time >= change_time
            speed[is_later] = _first(values, SPEEDS, fastest_speed)
            turn[is_later] = _first(values, TURNS, USUAL_TURN)
        elif server == "":
            rate = changed_values.get("controller_frequency", rate)
            rates.append((change_time, rate))
    return DriveLimits(
        speed=speed,
        turn=turn,
        tolerance=_first(values, ("xy_goal_tolerance",), TOLERANCE_M),
        scale=robot.world_scale,
        end=drive.end,
        yaw_tolerance=_first(values, ("yaw_goal_tolerance",), 0.0),
        rates=rates,
    )


def changes_of(drive: Drive, robot: Robot) -> List[Tuple[float, str, Dict[str, Any]]]:
    """Return the changes (time [s], server, {name: value}) of a drive in order of time.

    Of servers without recorded updates, the values come from the decisions. Values of an older node
    have their latest names.
    """
    changes: List[Tuple[float, str, Dict[str, Any]]] = []
    recorded_servers: Set[str] = set()
    if drive.changes is not None:
        rows = zip(drive.changes.time.tolist(), drive.changes.server, drive.changes.values)
        for time, server, values in rows:
            changes.append((time, server, latest_names(server, values)))
        recorded_servers.update(drive.changes.server)
    for decision in drive.decisions:
        for server, decided in unchecked_space(robot).settings_of(decision.after).items():
            if server not in recorded_servers:
                changes.append((decision.time, server, dict(decided)))
    changes.sort(key=lambda change: change[0])
    return changes


def latest_names(server: str, values: Mapping[str, Any]) -> Dict[str, Any]:
    """Return the values of a server {name: value} under the latest names of its parameters."""
    latest = dict(values)
    for parameter in SERVERS.get(server, ()):
        for older_name in parameter.older:
            if older_name in latest:
                latest.setdefault(parameter.name, latest.pop(older_name))
    return latest


def planner_of(drive: Drive, robot: Robot) -> str:
    """Return the local planner that drove: the robot's, unless only others have shown plans.

    Among several others, one that is replayed counts.
    """
    if not drive.planners or robot.local_planner in drive.planners:
        return robot.local_planner
    for planner in drive.planners:
        if planner in REPLAYED:
            return planner
    return drive.planners[0]


def start_values(robot: Robot) -> Mapping[str, Any]:
    """Return the parameters of a robot's local planner by its files."""
    planner = robot.local_planner
    if planner in REPLAYED:
        return dict(robot.all_parameters()[planner])
    values: Dict[str, Any] = robot.parameters().get(planner) or {}
    return values


def _first(values: Mapping[str, Any], names: Sequence[str], otherwise: float) -> float:
    """Return the first value that is a positive number, else another one."""
    for name in names:
        value = values.get(name)
        if isinstance(value, (int, float)) and value > 0:
            return float(value)
    return otherwise
