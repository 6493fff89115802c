"""Stalls: when a robot makes no progress, and what it drives with then, whatever its method.

Simulated trials (training/evaluate/runner.py) and the applr node share this rule.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, Optional, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.policy.decision import PERIOD, Context, Method
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.robots import Robot

# Stall of a robot of the Jackal's size: it is less than 0.85 m from its position 8 s ago.
STALL_DISTANCE_M = 0.85
STALL_TIME_S = 8.0
# A robot whose present speed ahead would take it that far in this time has come out [s].
OUT_TIME_S = 2.0
TIME_TOLERANCE_S = 1e-6  # tolerance of times that are sums of periods [s]
# While it backs out, TrajectoryPlannerROS drives back for a distance within BACKING_M [m], or for a
# rotation [rad]. It begins as soon as no way ahead is free for `sim_time` [s]. The distance is
# drawn, because the same one can end each time a little before the place where the robot could
# turn.
BACKING_M = (0.5, 1.0)
BACKING_OUT = {"escape_reset_theta": 3.14, "sim_time": 3.0}
BACKING_S = 8.0  # longest time in which the robot must have backed out [s]
DRIVING_S = 3.0  # duration of any other phase [s]
# Interval between two clearings of the costmaps [s], of which the first is at the beginning of a
# stall. A body that slides and turns hard spoils the odometry by decimetres. What the robot saw
# before then stands twice in the costmaps, and closes the way out.
CLEARING_S = 8.0
PLAN_M = 0.3  # length of the plan whose direction says whether the way out is behind [m]
BACKWARDS_M_S = 0.02  # speed backwards at which the robot backs out, not merely slips [m/s]
SEED = 0x57A1  # first number of the draws' seed, so that methods with the same seed draw others


class Stall:
    """Detector of a robot without progress.

    An example is a robot whose planner keeps turning and backing in a dead end.

    In training a stall ends the episode as a failure if `end_on_stall` is set
    (training/env/episode.py).

    Args:
        scale: Size of the robot relative to the Jackal (Robot.world_scale); scales the distance.

    Attributes:
        share: Displacement during the last STALL_TIME_S, divided by the required displacement; at
            most 1, and 1 during the first STALL_TIME_S.
    """

    def __init__(self, scale: float):
        self._required = STALL_DISTANCE_M * scale  # displacement without a stall [m]
        self.reset()

    def reset(self) -> None:
        """Forget all positions at the start of a course."""
        self.share = 1.0
        # Time [s], x [m] and y [m] of the latest decisions
        self._past: Deque[Tuple[float, float, float]] = deque()

    def update(self, time: float, x: float, y: float, v: float) -> bool:
        """Add a position, and return whether the robot has stalled.

        Args:
            time: Time [s].
            x: Position [m].
            y: Position [m].
            v: Speed ahead [m/s].
        """
        self._past.append((time, x, y))
        window_start = time - STALL_TIME_S + TIME_TOLERANCE_S
        # The first entry becomes the latest position that is old enough.
        while len(self._past) > 1 and self._past[1][0] <= window_start:
            self._past.popleft()
        oldest_time, *oldest_position = self._past[0]
        if oldest_time <= window_start:
            self.share = min(1.0, math.dist(oldest_position, (x, y)) / self._required)
        has_come_out = v * OUT_TIME_S >= self._required
        return self.share < 1.0 and not has_come_out


class StallRule:
    """Parameters of a robot that has stalled, in place of those of its method.

    The method's decisions have failed there. Each phase of a stall has random values of the
    parameters that a policy chooses; others stay as the method has them. A phase keeps its values,
    because a robot needs some seconds to back out of a dead end and to turn. If the plan leads
    back, the robot backs out (BACKING_OUT) until it has driven backwards, and drives for DRIVING_S,
    by turns. If the plan leads ahead, it drives with random parameters and with those of its
    method, by turns. The method comes first where the robot has turned, because it has failed in
    another direction. The costmaps are cleared every CLEARING_S. A method refuses with
    `redraws_stalled` (Method).

    Args:
        robot: Description of the robot.

    Attributes:
        count: Number of decisions changed so far.
        clears_costmaps: Whether the costmaps are to be cleared before the last decision takes
            effect.
    """

    def __init__(self, robot: Robot):
        self.count = 0
        self._encoding = DimensionlessEncoding(robot, PERIOD)
        self._stall = Stall(robot.world_scale)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the positions at the start of a course, and seed the draws."""
        self._stall.reset()
        self._draws = np.random.default_rng([seed, SEED])
        self._end()

    def _end(self) -> None:
        """Forget the last stall."""
        self._phase: Optional[_Phase] = None
        self._last_clearing = -math.inf  # time of the last clearing of the costmaps [s]
        self.clears_costmaps = False

    def instead(self, method: Method, context: Context, theta: Array) -> Optional[Array]:
        """Return parameters (n,) in place of the method's `theta` (n,), or None to keep these."""
        x, y, _ = context.pose
        v, _ = context.twist
        has_stalled = self._stall.update(context.time, x, y, v)
        if not has_stalled or not method.redraws_stalled:
            self._end()
            return None
        since_clearing = context.time - self._last_clearing
        self.clears_costmaps = since_clearing + TIME_TOLERANCE_S >= CLEARING_S
        if self.clears_costmaps:
            self._last_clearing = context.time
        leads_back = _leads_back(context)
        phase = self._phase
        if phase is None:
            phase = self._begin(context.time, leads_back, is_first=True)
        elif phase.leads_back != leads_back:
            phase = self._begin(context.time, leads_back, is_first=leads_back)
        elif phase.has_ended(context.time, v):
            phase = self._begin(context.time, leads_back, is_first=not phase.is_first)
        if not phase.values:
            return None
        self.count += 1
        space = self._encoding.space
        parameters = {**space.as_dict(theta), **phase.values}
        return space.clip([parameters[name] for name in space.names])

    def _begin(self, time: float, leads_back: bool, is_first: bool) -> _Phase:
        """Begin a phase at a time [s]."""
        phase_values: Dict[str, float] = {}
        if leads_back or is_first:
            phase_values = self._values(backs_out=leads_back and is_first)
        self._phase = _Phase(time, leads_back, is_first, phase_values)
        return self._phase

    def _values(self, backs_out: bool) -> Dict[str, float]:
        """Draw the values {name: value} of a phase."""
        space = self._encoding.space
        action = self._draws.uniform(-1.0, 1.0, self._encoding.actions)
        distance = self._draws.uniform(*BACKING_M)
        drawn_parameters = space.as_dict(self._encoding.theta(action))
        drawn_values = {name: drawn_parameters[name] for name in self._encoding.chosen}
        # Only TrajectoryPlannerROS backs out.
        if backs_out and "escape_reset_dist" in space.names:
            drawn_values.update(BACKING_OUT, escape_reset_dist=distance)
        return drawn_values


class _Phase:
    """Part of a stall in which the parameters stay.

    Args:
        began: Time of its beginning [s].
        leads_back: Whether the plan leads back.
        is_first: Whether it is the first of the two kinds of phases that alternate: backing out, or
            random parameters where the plan leads ahead.
        values: {name: value} of the parameters that it changes; empty if the method decides.
    """

    def __init__(self, began: float, leads_back: bool, is_first: bool, values: Dict[str, float]):
        self.leads_back = leads_back
        self.is_first = is_first
        self.values = values
        self._began = began
        self._has_driven_back = False

    def has_ended(self, time: float, v: float) -> bool:
        """Return whether the phase is over at a decision at `time` [s] and speed v ahead [m/s]."""
        duration = time - self._began + TIME_TOLERANCE_S
        if not (self.leads_back and self.is_first):
            return duration >= DRIVING_S
        drives_back = v < -BACKWARDS_M_S
        self._has_driven_back |= drives_back
        has_backed_out = self._has_driven_back and not drives_back
        return has_backed_out or duration >= BACKING_S


def _leads_back(context: Context) -> bool:
    """Return whether the plan begins behind the robot. Without a plan, it does."""
    plan = np.asarray(context.plan)[:, :2]
    x, y, yaw = context.pose
    distances = np.hypot(plan[:, 0] - x, plan[:, 1] - y)
    reached_indices = np.flatnonzero(distances >= PLAN_M)
    if not len(reached_indices):
        return True
    ahead_x, ahead_y = plan[reached_indices[0]]
    forward = math.cos(yaw) * (ahead_x - x) + math.sin(yaw) * (ahead_y - y)
    return bool(forward < 0.0)
