"""Alternatives: how the planner would have driven on from recorded cycles with another value of one parameter.

From each cycle, the planner drives on for AHEAD control cycles on the recorded map; its commands are followed exactly.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
from typing_extensions import override

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.parameters.parameter import Parameter
from training.why.explanation import arc, lethal_points
from training.why.replay import Cycle, Replay

AHEAD = 40  # number of control cycles for which the planner drives on
FACTORS = (0.125, 0.5, 2.0, 8.0)  # changes of a value that are tried, beside the default of the C++ planner
FEW = 2  # step between the cycles from which a value is tried first
ELSEWHERE = 4  # number of alternatives that are also driven from cycles outside the events
LITTLE = 0.01  # gain of speed up to which an alternative does not count [m/s]
WITHIN = 0.8  # share of the largest gain from which on alternatives are nearly equal
# Parameters that are not tried, because they set the speed that is wanted, forbid to be slow, or cannot free a robot
LEFT_OUT = (
    "restore_defaults", "enabled", "acc_lim_y", "vy_samples", "holonomic_robot", "max_vel_x", "min_vel_x",
    "max_vel_trans", "min_vel_trans", "escape_vel", "dwa", "use_dwa", "prune_plan", "xy_goal_tolerance",
    "yaw_goal_tolerance",
)  # fmt: skip


Values = Dict[Tuple[str, Parameter], List[Any]]  # other values by server and parameter


@dataclass
class Alternative:
    """Another value of one parameter, with mean results of `drive_on` from some cycles."""

    server: str
    parameter: Parameter
    now: Any  # value in force
    then: Any  # the other value
    before: np.ndarray  # speed [m/s] and distance from obstacles [m] with the value in force
    after: np.ndarray  # the same with the other value
    elsewhere: float = 0.0  # change of the speed from cycles outside the events [m/s]

    @property
    def gain(self) -> float:
        """Gain of speed along the plan [m/s]."""
        return float(self.after[0] - self.before[0])

    @property
    def departure(self) -> Tuple[bool, float, float]:
        """Direction (True: away from the default), nearness of the value in force to it, and size of the change."""
        default = self.parameter.default
        away = abs(self.then - default) > abs(self.now - default)
        return away, -_distance(self.now, default), _distance(self.now, self.then)

    @property
    def change(self) -> str:
        """Name of the parameter with both values."""
        return f"{self.parameter.name} {self.now:.4g} -> {self.then:.4g}"

    @override
    def __str__(self) -> str:
        (slow, near), (fast, nearer) = self.before, self.after
        rest = f"{near:.2f} -> {nearer:.2f} m from obstacles, {self.elsewhere:+.2f} m/s elsewhere"
        return f"{self.change}: {slow:.2f} -> {fast:.2f} m/s along the plan, {rest}"


def _distance(a: float, b: float) -> float:
    """Return the logarithm of the ratio of two values; their difference if one is 0 or the signs differ."""
    return abs(math.log(a / b)) if a * b > 0 else abs(a - b)


def other_values(replay: Replay) -> Values:
    """Return the values to try of the local planner's parameters and those of the local inflation layers."""
    found: Values = {}
    for server in (replay.server, *(f"local_costmap/{layer.name}" for layer in replay.costmap.inflation_layers)):
        for one in replay.move_base.servers[server].parameters:
            now = replay.settings[server][one.name]
            if one.name not in LEFT_OUT and not isinstance(now, str):
                factors = () if isinstance(now, bool) else FACTORS
                values = {one.clamp(one.convert(now * factor)) for factor in factors} | {one.default}
                found[server, one] = sorted(values - {now})
    return found


def drive_on(replay: Replay, cycles: Sequence[Cycle], server: str, changes: Dict[str, Any]) -> np.ndarray:
    """Drive on from cycles with other values of a server.

    Returns:
        (n, 2) mean speeds along the plan [m/s], and smallest distances of the robot's centre from an obstacle [m].
    """
    results = []
    for cycle in cycles:
        now = cycle.settings[server]
        values = {**now, **changes}
        if "max_vel_theta" in changes and now["min_vel_theta"] == -now["max_vel_theta"]:
            values["min_vel_theta"] = -values["max_vel_theta"]  # Symmetric limits stay so.
        replay.put_in_force({**cycle.settings, server: values})
        replay.costmap.restore(cycle.map, cycle.pose)
        replay.begin(cycle)
        poses, twist = [cycle.pose], cycle.twist
        while len(poses) <= AHEAD:
            v, w = twist = replay.local.compute_velocity(poses[-1], twist, replay.costmap)[1]
            poses.append(arc(poses[-1], v, w, replay.period))
        track, plan = np.array(poses)[:, :2], cycle.plan[:, :2]
        way = np.concatenate([[0.0], np.hypot(*np.diff(plan, axis=0).T).cumsum()])
        first, last = (way[np.hypot(*(plan - end).T).argmin()] for end in track[[0, -1]])
        distances = np.hypot(*(track[::4, None] - lethal_points(replay)).T)
        results.append(((last - first) / (AHEAD * replay.period), distances.min(initial=np.inf)))
    return np.array(results).reshape(-1, 2)


def best_values(replay: Replay, values: Values, cycles: Sequence[Cycle], others: Sequence[Cycle]) -> List[Alternative]:
    """Return, of each parameter, the best value with which the planner would have driven on faster from some cycles.

    Changes that bring the robot nearer to obstacles than its inscribed circle are left out. `others` are cycles outside
    the events.
    """
    before, usual = (drive_on(replay, given, replay.server, {}) for given in (cycles, others))
    nearest = min(before[:, 1].min(initial=np.inf), replay.costmap.inscribed_radius - replay.costmap.resolution)
    found = []
    for (server, parameter), tried in values.items() if len(cycles) else ():
        gains, now = [], cycles[0].settings[server][parameter.name]
        for then in tried:
            with suppress(ApplrError):  # The value may contradict that of another parameter.
                after = drive_on(replay, cycles[::FEW], server, {parameter.name: then})
                if (after - before[::FEW])[:, 0].mean() > LITTLE:
                    after = drive_on(replay, cycles, server, {parameter.name: then})
                    one = Alternative(server, parameter, now, then, before.mean(axis=0), after.mean(axis=0))
                    gains += [one] if one.gain > LITTLE and after[:, 1].min() >= nearest else []
        found += ranked(gains)[:1]
    found = ranked(found)
    for one in found[:ELSEWHERE] if len(others) else ():
        one.elsewhere = float(
            (drive_on(replay, others, one.server, {one.parameter.name: one.then}) - usual)[:, 0].mean()
        )
    return found


def ranked(alternatives: Sequence[Alternative]) -> List[Alternative]:
    """Return alternatives, the best first.

    Among nearly equal ones, changes towards the default come first, of the parameter that is farthest from it, and
    small ones.
    """
    left, order = list(alternatives), []
    while left:
        most = max(one.gain for one in left)
        order.append(min((one for one in left if one.gain >= WITHIN * most), key=lambda one: one.departure))
        left.remove(order[-1])
    return order
