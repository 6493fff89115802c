"""Recovery behaviours of a stuck move_base: clear the costmaps far away, or rotate once in place.

MoveBase holds one object per behaviour and calls step() once per control cycle until it returns
None, so a rotation can be cancelled between two cycles.
"""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Union

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.parameters.move_base_parameters import (
    DEFAULT_RECOVERIES,
    RECOVERY_TYPES,
)
from applr_ros1.planner.parameters.trees import Tree
from applr_ros1.planner.sampling_planner import angle_difference

# Time limit of a rotation as a multiple of its unhindered time. C++ has no limit.
PATIENCE = 4.0


class ClearCostmapRecovery:
    """Recovery that clears obstacles outside a square around the robot.

    It clears both costmaps, the global one first, and unlike C++ all obstacle layers, whatever
    their names. The next update marks the latest scan again.

    Args:
        name: name of the behaviour.
        side: side of the square [m].
        like_cpp: whether to clear nothing. C++ clears only "obstacles", but the Jackal's layer is
            "obstacles_layer".
    """

    def __init__(self, name: str, side: float, like_cpp: bool = False):
        self.name = name
        self.side = side
        self._clears = not like_cpp

    def start(self, now: float, pose: Pose) -> None:
        """Begin at time `now` [s]. The behaviour has no state."""

    def step(
        self,
        now: float,
        pose: Pose,
        local_costmap: Costmap,
        global_costmap: Costmap,
        global_pose: Optional[Pose] = None,
    ) -> Optional[Twist]:
        """Clear the costmaps and return None: the behaviour ends within its first cycle.

        global_pose: pose in the global costmap's frame, or None if it equals `pose`.
        """
        if self._clears:
            global_costmap.clear_outside(global_pose or pose, self.side)
            local_costmap.clear_outside(pose, self.side)
        return None


class RotateRecovery:
    """Recovery that rotates once anticlockwise in place. rotate_recovery.cpp:93.

    As in C++, half a turn and a full turn count as reached within the yaw tolerance. A control rate
    below 20 Hz may skip these yaws, so the accumulated rotation counts, too.

    Args:
        name: name of the behaviour.
        planner: parameters of TrajectoryPlannerROS at start-up, for limits [rad/s, rad/s^2] and
            tolerance [rad].
        sim_granularity: step between the yaws at which the footprint is tested [rad].
        like_cpp: whether an incomplete rotation goes on forever.
    """

    def __init__(
        self,
        name: str,
        planner: Tree,
        sim_granularity: float = 0.017,
        like_cpp: bool = False,
    ):
        self.name = name
        self.acceleration = planner["acc_lim_theta"]
        self.fastest_turn = planner["max_vel_theta"]
        self.slowest_turn = planner["min_in_place_vel_theta"]
        self.tolerance = planner["yaw_goal_tolerance"]
        self.granularity = sim_granularity
        self._patience = math.inf if like_cpp else PATIENCE
        self._start_yaw = 0.0
        self._last_yaw = 0.0
        self._turned = 0.0  # accumulated rotation [rad]
        self._is_past_half = False
        self._deadline = 0.0

    def start(self, now: float, pose: Pose) -> None:
        """Record the yaw at which the rotation begins, and set its deadline."""
        self._start_yaw = pose[2]
        self._last_yaw = pose[2]
        self._turned = 0.0
        self._is_past_half = False
        # A maximum of 0 gives a long time instead of an error.
        unhindered_time = 2.0 * math.pi / max(self.fastest_turn, 1e-3)
        self._deadline = now + self._patience * unhindered_time

    def step(
        self,
        now: float,
        pose: Pose,
        local_costmap: Costmap,
        global_costmap: Costmap,
        global_pose: Optional[Pose] = None,
    ) -> Optional[Twist]:
        """Return the next command (0, w [rad/s]).

        Return None when the rotation is complete, blocked or takes too long.
        """
        x, y, yaw = pose

        # As in C++, the end is recognised in the cycle after the yaw was reached.
        angle_to_start = abs(angle_difference(self._last_yaw, self._start_yaw))
        is_complete = self._is_past_half and angle_to_start <= self.tolerance
        self._turned += angle_difference(self._last_yaw, yaw)
        if is_complete or now > self._deadline or self._turned >= 2.0 * math.pi:
            return None
        self._last_yaw = yaw

        # Until half a turn is done, the way leads through the opposite yaw.
        if self._is_past_half:
            remaining_turn = abs(angle_difference(yaw, self._start_yaw))
        else:
            angle_to_half = abs(angle_difference(yaw, self._start_yaw + math.pi))
            remaining_turn = math.pi + angle_to_half
            self._is_past_half = angle_to_half < self.tolerance or self._turned > math.pi

        # The whole rest of the rotation must be free.
        turn_ahead = 0.0
        while turn_ahead < remaining_turn:
            if local_costmap.footprint_cost(x, y, yaw + turn_ahead) < 0.0:
                return None
            turn_ahead += self.granularity

        # The fastest turn that can still stop after the rest.
        braking_speed = math.sqrt(2.0 * self.acceleration * remaining_turn)
        return 0.0, min(max(braking_speed, self.slowest_turn), self.fastest_turn)


Behaviour = Union[ClearCostmapRecovery, RotateRecovery]


def build(parameters: Tree, like_cpp: bool = False) -> List[Behaviour]:
    """Return the behaviours in order, from a complete parameter tree, as C++ does at start-up.

    The default list omits rotations if `clearing_rotation_allowed` is False. A custom list is used
    unchanged (move_base.cpp, loadRecoveryBehaviors). An entry that is listed twice is one object.

    Args:
        parameters: complete parameter tree.
        like_cpp: whether the behaviours have the defects of C++.
    """
    entries = parameters["recovery_behaviors"]
    omits_rotations = entries == DEFAULT_RECOVERIES and not parameters["clearing_rotation_allowed"]
    behaviours: Dict[str, Behaviour] = {}
    sequence = []
    for entry in entries:
        behaviour_name = entry["name"]
        clears = entry["type"] == RECOVERY_TYPES[0]
        if omits_rotations and not clears:
            continue
        if behaviour_name not in behaviours:
            behaviours[behaviour_name] = _make(behaviour_name, clears, parameters, like_cpp)
        sequence.append(behaviours[behaviour_name])
    return sequence


def _make(name: str, clears: bool, parameters: Tree, like_cpp: bool) -> Behaviour:
    if clears:
        return ClearCostmapRecovery(name, parameters[name]["reset_distance"], like_cpp)
    # As in C++, the limits are those of this planner, whichever drives.
    planner = parameters["TrajectoryPlannerROS"]
    return RotateRecovery(name, planner, parameters[name]["sim_granularity"], like_cpp)
