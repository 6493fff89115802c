"""Stuck: who finds that the robot is stuck, and what is done about it, in this order.

1. Commands do not pass: for half a second the collision monitor blocks nearly all of each command,
   or for two seconds the planner finds none. Then an Escape (planner/escape.py) makes small
   motions. This package's planner has it in its state machine. A planner without one, such as the
   C++ move_base, is watched from outside by a StalledPlanner (stack/command_chain.py).
2. The planner has no plan or no command for its patience, oscillates, or all escape motions have
   failed: the recoveries of C++ (planner/recovery.py), in the same state machine.
3. The robot stays at its place or in a dead end for seconds, whatever it is commanded: Stuck. The
   StallRule (stall_rule.py) then clears the costmaps and replaces the method's parameters.
4. In training, a Stall of the true position may end the course (drives/end_rules.py).

The first two act on single commands, in each control cycle, the others on decisions.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Deque, Optional, Tuple

from applr_ros1.common.angles import Pose
from applr_ros1.common.times import TIME_TOLERANCE_S

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
        self.forget_positions()

    def forget_positions(self) -> None:
        """Forget all positions at the start of a course."""
        self.share = 1.0
        # Time [s], x [m] and y [m] of the latest decisions
        self._past: Deque[Tuple[float, float, float]] = deque()

    def add_position(self, time: float, x: float, y: float, v: float) -> bool:
        """Add a position, and return whether the robot has stalled.

        Args:
            time: Time [s].
            x: Position [m].
            y: Position [m].
            v: Speed ahead [m/s].
        """
        self._past.append((time, x, y))
        window_start = time - STALL_TIME_S + TIME_TOLERANCE_S
        _forget_before(window_start, self._past)
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
        self.forget_poses()

    def forget_poses(self) -> None:
        """Forget all poses."""
        self.stands = False
        # Time [s] and pose of the latest decisions, and of those since the plan has led back
        self._past: Deque[Tuple[float, Pose]] = deque()
        self._past_backward: Deque[Tuple[float, Pose]] = deque()

    def add_pose(self, time: float, pose: Pose, leads_back: Optional[bool]) -> bool:
        """Add a pose, and return whether the robot is in a dead end.

        Args:
            time: Time [s].
            pose: (x, y, yaw) of the robot [m, rad].
            leads_back: Whether the plan leads back; None without a plan, or near its end.
        """
        if leads_back is None:
            self.forget_poses()
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
        self.forget_decisions()

    def forget_decisions(self) -> None:
        """Forget all positions at the start of a course."""
        self._stall.forget_positions()
        self._dead_end.forget_poses()
        self._begin_place: Optional[Tuple[float, float]] = None  # place at which it got stuck [m]

    @property
    def stands(self) -> bool:
        """True if the robot has stood for DEAD_END_S."""
        return self._dead_end.stands

    def add_decision(self, time: float, pose: Pose, v: float, leads_back: Optional[bool]) -> bool:
        """Add a pose, and return whether the robot is stuck.

        Args:
            time: Time [s].
            pose: (x, y, yaw) of the robot [m, rad].
            v: Speed ahead [m/s].
            leads_back: Whether the plan leads back; None without a plan, or near its end.
        """
        x, y, _ = pose
        has_stalled = self._stall.add_position(time, x, y, v)
        is_in_dead_end = self._dead_end.add_pose(time, pose, leads_back)
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


def _forget_before(time: float, past: Deque[Any]) -> None:
    """Remove the first entries, so that the latest one until `time` [s] comes first."""
    while len(past) > 1 and past[1][0] <= time:
        past.popleft()


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
    _forget_before(begin_time, past)
    for _, (past_x, past_y, past_yaw) in past:
        moved_distance = math.hypot(x - past_x, y - past_y)
        turned_angle = abs(math.remainder(yaw - past_yaw, 2.0 * math.pi))
        if moved_distance >= distance or turned_angle >= angle:
            return False
    return past[0][0] <= begin_time
