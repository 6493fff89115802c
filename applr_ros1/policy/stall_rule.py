"""Stall rule: the parameters of a robot that is stuck (stuck.py), in place of its method's.

The Pilot (pilot.py) applies this rule, on the robot and in simulated trials.
"""

from __future__ import annotations

import math
from typing import Dict, Optional

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.times import TIME_TOLERANCE_S
from applr_ros1.policy.decision import PERIOD, Context, Method
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.parameter_space import INFLATION_RADIUS
from applr_ros1.policy.stuck import DEAD_END_S, Stuck
from applr_ros1.robots import Robot

# While it backs out, TrajectoryPlannerROS drives back for a distance within BACKING_M [m], or for a
# rotation [rad]. It begins as soon as no way ahead is free for `sim_time` [s]. The distance is
# drawn, because the same one can end each time a little before the place where the robot could
# turn.
BACKING_M = (0.5, 1.0)
BACKING_OUT = {"escape_reset_theta": 3.14, "sim_time": 3.0}
# Smallest speed ahead while it backs out [m/s]. A way ahead at the default of 0.1 m/s is nearly
# always free, and the robot would creep on into the dead end for seconds.
AHEAD_M_S = 0.5
BACKING_S = 8.0  # longest time in which the robot must have backed out [s]
DRIVING_S = 3.0  # duration of any other phase [s]
# Interval between two clearings of the costmaps [s], of which the first is at the beginning of a
# stall. A body that slides and turns hard spoils the odometry by decimetres. What the robot saw
# before then stands twice in the costmaps, and closes the way out.
CLEARING_S = 8.0
# Parameters that decide which gaps a plan may lead through. A robot whose set has a wider padding
# than its files can stand where the padded footprint does not fit: no plan leads out of there.
GAP_PARAMETERS = ("footprint_padding", INFLATION_RADIUS)
PLAN_M = 0.3  # length of the plan whose direction says whether the way out is behind [m]
BACKWARDS_M_S = 0.02  # speed backwards at which the robot backs out, not merely slips [m/s]
SEED = 0x57A1  # first number of the draws' seed, so that methods with the same seed draw others


class StallRule:
    """Parameters of a robot that is stuck (Stuck), in place of those of its method.

    The method's decisions have failed there.

    Each phase of a stall has random values of the parameters that a policy chooses; others stay as
    the method has them. A phase keeps its values, because a robot needs some seconds to back out of
    a dead end and to turn. If the plan leads back, the robot backs out (BACKING_OUT) until it has
    driven backwards or has stood, and drives for DRIVING_S, by turns. If the plan leads ahead, it
    drives with random parameters and with those of its method, by turns. The method comes first
    where the robot has turned, because it has failed in another direction. The costmaps are cleared
    every CLEARING_S. Once the robot has stood, draws leave GAP_PARAMETERS as in its files until the
    stall ends. A robot within the tolerance of its goal is not stuck. A method refuses with
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
        self._stuck = Stuck(robot.world_scale)
        self._goal_tolerance = robot.goal_tolerance
        self.begin_course(0)

    def begin_course(self, seed: int) -> None:
        """Forget the positions at the start of a course, and seed the draws."""
        self._stuck.forget_decisions()
        self._draws = np.random.default_rng([seed, SEED])
        self._end()

    def _end(self) -> None:
        """Forget the last stall."""
        self._phase: Optional[_Phase] = None
        self._last_clearing = -math.inf  # time of the last clearing of the costmaps [s]
        self._has_stood = False  # whether the robot has stood for DEAD_END_S in this stall
        self.clears_costmaps = False

    def redraw(self, method: Method, context: Context, theta: Array) -> Optional[Array]:
        """Return parameters (n,) in place of the method's `theta` (n,), or None to keep these.

        The Pilot clips them, and orders the smallest and the largest speed.
        """
        plan_leads_back = _leads_back(context)
        v, _ = context.twist
        is_stuck = self._stuck.add_decision(context.time, context.pose, v, plan_leads_back)
        # A robot that stands within the tolerance has arrived, or turns to the goal's heading.
        goal_distance = math.dist(context.pose[:2], context.goal[:2])
        has_arrived = goal_distance <= self._goal_tolerance
        if not is_stuck or has_arrived or not method.redraws_stalled:
            self._end()
            return None
        since_clearing = context.time - self._last_clearing
        self.clears_costmaps = since_clearing + TIME_TOLERANCE_S >= CLEARING_S
        if self.clears_costmaps:
            self._last_clearing = context.time
        self._has_stood |= self._stuck.stands
        # Without a plan, the way out is behind.
        leads_back = plan_leads_back is not False
        phase = self._phase
        if phase is None:
            phase = self._begin(context.time, leads_back, is_first=True)
        elif phase.leads_back != leads_back:
            phase = self._begin(context.time, leads_back, is_first=leads_back)
        elif phase.is_over(context.time, v, self._stuck.stands):
            phase = self._begin(context.time, leads_back, is_first=not phase.is_first)
        if not phase.values:
            return None
        self.count += 1
        names = self._encoding.space.names
        parameters = {**dict(zip(names, theta)), **phase.values}
        return np.array([parameters[name] for name in names])

    def _begin(self, time: float, leads_back: bool, is_first: bool) -> _Phase:
        """Begin a phase at a time [s]."""
        phase_values = {}
        if leads_back or is_first:
            phase_values = self._values(backs_out=leads_back and is_first)
        self._phase = _Phase(time, leads_back, is_first, phase_values)
        return self._phase

    def _values(self, backs_out: bool) -> Dict[str, float]:
        """Draw the values {name: value} of a phase."""
        space = self._encoding.space
        action = self._draws.uniform(-1.0, 1.0, self._encoding.actions)
        distance = self._draws.uniform(*BACKING_M)
        drawn_parameters = dict(zip(space.names, self._encoding.theta(action)))
        drawn_values = {name: drawn_parameters[name] for name in self._encoding.chosen}
        if self._has_stood:
            for name, default in zip(space.names, space.theta0):
                if name in GAP_PARAMETERS:
                    drawn_values[name] = default
        # Only TrajectoryPlannerROS backs out.
        if backs_out and "escape_reset_dist" in space.names:
            drawn_values.update(BACKING_OUT, escape_reset_dist=distance)
            if "max_vel_x" in space.names:
                drawn_values["min_vel_x"] = AHEAD_M_S
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

    def is_over(self, time: float, v: float, stands: bool) -> bool:
        """Return whether the phase is over.

        Args:
            time: Time of a decision [s].
            v: Speed ahead [m/s].
            stands: Whether the robot has stood for DEAD_END_S.
        """
        duration = time - self._began + TIME_TOLERANCE_S
        if not (self.leads_back and self.is_first):
            return duration >= DRIVING_S
        drives_back = v < -BACKWARDS_M_S
        self._has_driven_back |= drives_back
        has_backed_out = self._has_driven_back and not drives_back
        # The planner has no command, or something behind the robot blocks it.
        is_held = stands and duration >= DEAD_END_S
        return has_backed_out or is_held or duration >= BACKING_S


def _leads_back(context: Context) -> Optional[bool]:
    """Return whether the plan begins behind the robot; None without a plan of PLAN_M."""
    plan = np.asarray(context.plan)[:, :2]
    x, y, yaw = context.pose
    distances = np.hypot(plan[:, 0] - x, plan[:, 1] - y)
    reached_indices = np.flatnonzero(distances >= PLAN_M)
    if not len(reached_indices):
        return None
    ahead_x, ahead_y = plan[reached_indices[0]]
    forward = math.cos(yaw) * (ahead_x - x) + math.sin(yaw) * (ahead_y - y)
    return bool(forward < 0.0)
