"""Stalls: when a robot makes no progress, and what it drives with then, whatever its method.

The Pilot (pilot.py) applies this rule, on the robot and in simulated trials.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array
from applr_ros1.common.times import TIME_TOLERANCE_S
from applr_ros1.policy.decision import PERIOD, Context, Method
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.robots import Robot

# Stall of a robot of the Jackal's size: it is less than 0.85 m from its position 8 s ago.
STALL_DISTANCE_M = 0.85
STALL_TIME_S = 8.0
# A robot whose present speed ahead would take it that far in this time has come out [s].
OUT_TIME_S = 2.0
# A dead end is clear after DEAD_END_S [s]: the plan has led back, and the robot has neither moved
# by BACKWARD_M [m] nor turned by BACKWARD_RAD [rad]. Whatever the plan, it is clear if the robot
# has stood, without a command or because a monitor blocks its commands.
DEAD_END_S = 2.0
BACKWARD_M = 0.2
BACKWARD_RAD = 0.5
STANDING_M = 0.05
STANDING_RAD = 0.1
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
PLAN_M = 0.3  # length of the plan whose direction says whether the way out is behind [m]
BACKWARDS_M_S = 0.02  # speed backwards at which the robot backs out, not merely slips [m/s]
SEED = 0x57A1  # first number of the draws' seed, so that methods with the same seed draw others


class Stall:
    """Detector of a robot without progress.

    An example is a robot whose planner keeps turning and backing in a dead end.

    In training a stall ends the episode as a failure if `end_on_stall` is set
    (drives/end_rules.py).

    Args:
        scale: Size of the robot relative to the Jackal (Robot.world_scale); scales the distance.

    Attributes:
        required: Displacement without a stall [m].
        share: Displacement during the last STALL_TIME_S, divided by the required displacement; at
            most 1, and 1 during the first STALL_TIME_S.
    """

    def __init__(self, scale: float):
        self.required = STALL_DISTANCE_M * scale
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
            self.share = min(1.0, math.dist(oldest_position, (x, y)) / self.required)
        return self.share < 1.0 and not self.comes_out(v)

    def comes_out(self, v: float) -> bool:
        """Return whether a robot at speed v ahead [m/s] is about to leave its place."""
        return v * OUT_TIME_S >= self.required


class DeadEnd:
    """Detector of a dead end that is clear before the robot has stalled.

    Args:
        scale: Size of the robot relative to the Jackal (Robot.world_scale); scales distances.

    Attributes:
        stands: Whether the robot has stood for DEAD_END_S.
    """

    def __init__(self, scale: float):
        self._scale = scale
        self.reset()

    def reset(self) -> None:
        """Forget all poses."""
        self.stands = False
        # Time [s] and pose of the latest decisions, and of those since the plan has led back
        self._past: Deque[Tuple[float, Pose]] = deque()
        self._past_backward: Deque[Tuple[float, Pose]] = deque()

    def update(self, time: float, pose: Pose, leads_back: Optional[bool]) -> bool:
        """Add a pose, and return whether the robot is in a dead end.

        Args:
            time: Time [s].
            pose: (x, y, yaw) of the robot [m, rad].
            leads_back: Whether the plan leads back; None without a plan, or near its end.
        """
        if leads_back is None:
            self.reset()
            return False
        self._past.append((time, pose))
        self.stands = _stays(self._past, STANDING_M * self._scale, STANDING_RAD)
        if not leads_back:
            self._past_backward.clear()
            return self.stands
        self._past_backward.append((time, pose))
        gets_nowhere = _stays(self._past_backward, BACKWARD_M * self._scale, BACKWARD_RAD)
        return self.stands or gets_nowhere


class Stuck:
    """Detector of a robot that has stalled or is in a dead end, until it has come out.

    It has come out when it has moved away from where this was found, or drives ahead fast enough.

    Args:
        scale: Size of the robot relative to the Jackal (Robot.world_scale); scales distances.
    """

    def __init__(self, scale: float):
        self._stall = Stall(scale)
        self._dead_end = DeadEnd(scale)
        self.reset()

    def reset(self) -> None:
        """Forget all positions at the start of a course."""
        self._stall.reset()
        self._dead_end.reset()
        self._begin_place: Optional[Tuple[float, float]] = None  # place at which it got stuck [m]

    @property
    def stands(self) -> bool:
        """True if the robot has stood for DEAD_END_S."""
        return self._dead_end.stands

    def update(self, time: float, pose: Pose, v: float, leads_back: Optional[bool]) -> bool:
        """Add a pose, and return whether the robot is stuck.

        Args:
            time: Time [s].
            pose: (x, y, yaw) of the robot [m, rad].
            v: Speed ahead [m/s].
            leads_back: Whether the plan leads back; None without a plan, or near its end.
        """
        x, y, _ = pose
        has_stalled = self._stall.update(time, x, y, v)
        is_in_dead_end = self._dead_end.update(time, pose, leads_back)
        if self._stall.comes_out(v):
            is_stuck = False
        elif self._begin_place is None:
            is_stuck = has_stalled or is_in_dead_end
        else:
            is_near = math.dist(self._begin_place, (x, y)) < self._stall.required
            is_stuck = has_stalled or is_near

        if not is_stuck:
            self._begin_place = None
        elif self._begin_place is None:
            self._begin_place = (x, y)
        return is_stuck


class StallRule:
    """Parameters of a robot that is stuck (Stuck), in place of those of its method.

    The method's decisions have failed there.

    Each phase of a stall has random values of the parameters that a policy chooses; others stay as
    the method has them. A phase keeps its values, because a robot needs some seconds to back out of
    a dead end and to turn. If the plan leads back, the robot backs out (BACKING_OUT) until it has
    driven backwards or has stood, and drives for DRIVING_S, by turns. If the plan leads ahead, it
    drives with random parameters and with those of its method, by turns. The method comes first
    where the robot has turned, because it has failed in another direction. The costmaps are cleared
    every CLEARING_S. A method refuses with `redraws_stalled` (Method).

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
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the positions at the start of a course, and seed the draws."""
        self._stuck.reset()
        self._draws = np.random.default_rng([seed, SEED])
        self._end()

    def _end(self) -> None:
        """Forget the last stall."""
        self._phase: Optional[_Phase] = None
        self._last_clearing = -math.inf  # time of the last clearing of the costmaps [s]
        self.clears_costmaps = False

    def instead(self, method: Method, context: Context, theta: Array) -> Optional[Array]:
        """Return parameters (n,) in place of the method's `theta` (n,), or None to keep these.

        The Pilot clips them, and orders the smallest and the largest speed.
        """
        plan_leads_back = _leads_back(context)
        v, _ = context.twist
        is_stuck = self._stuck.update(context.time, context.pose, v, plan_leads_back)
        if not is_stuck or not method.redraws_stalled:
            self._end()
            return None
        since_clearing = context.time - self._last_clearing
        self.clears_costmaps = since_clearing + TIME_TOLERANCE_S >= CLEARING_S
        if self.clears_costmaps:
            self._last_clearing = context.time
        # Without a plan, the way out is behind.
        leads_back = plan_leads_back is not False
        phase = self._phase
        if phase is None:
            phase = self._begin(context.time, leads_back, is_first=True)
        elif phase.leads_back != leads_back:
            phase = self._begin(context.time, leads_back, is_first=leads_back)
        elif phase.has_ended(context.time, v, self._stuck.stands):
            phase = self._begin(context.time, leads_back, is_first=not phase.is_first)
        if not phase.values:
            return None
        self.count += 1
        names = self._encoding.space.names
        parameters = {**dict(zip(names, theta)), **phase.values}
        return np.array([parameters[name] for name in names])

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
        drawn_parameters = dict(zip(space.names, self._encoding.theta(action)))
        drawn_values = {name: drawn_parameters[name] for name in self._encoding.chosen}
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

    def has_ended(self, time: float, v: float, stands: bool) -> bool:
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


def _stays(past: Deque[Tuple[float, Pose]], distance: float, angle: float) -> bool:
    """Return whether all poses of DEAD_END_S are within distance [m] and angle [rad].

    Poses before this time are removed.

    Args:
        past: Time [s] and pose (x, y, yaw) of past decisions, at least one.
        distance: Distance from the latest pose that the robot must have moved [m].
        angle: Angle from the latest pose that it must have turned [rad].
    """
    latest_time, latest_pose = past[-1]
    x, y, yaw = latest_pose
    begin_time = latest_time - DEAD_END_S + TIME_TOLERANCE_S
    while len(past) > 1 and past[1][0] <= begin_time:
        past.popleft()
    for _, (past_x, past_y, past_yaw) in past:
        moved_distance = math.hypot(x - past_x, y - past_y)
        turned_angle = abs(math.remainder(yaw - past_yaw, 2.0 * math.pi))
        if moved_distance >= distance or turned_angle >= angle:
            return False
    return past[0][0] <= begin_time
