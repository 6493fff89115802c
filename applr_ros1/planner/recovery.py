"""Recovery behaviours of a stuck move_base: clear the costmaps away from the robot, or rotate once in place.

MoveBase holds one object per behaviour and calls step() once per control cycle until it returns None, so a rotation
can be cancelled between two cycles.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Tuple, Union

from applr_ros1.common.angles import Pose
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.parameters.move_base_parameters import DEFAULT_RECOVERIES, RECOVERY_TYPES
from applr_ros1.planner.sampling_planner import angle_difference

PATIENCE = 4.0  # time limit of a rotation as a multiple of its unhindered time (C++ has no limit)


class ClearCostmapRecovery:
    """Recovery that clears obstacles outside a square around the robot, in both costmaps, global first.

    Unlike C++, it clears all obstacle layers, whatever their names. The next update marks the latest scan again.

    Args:
        name: name of the behaviour.
        side: side of the square [m].
        like_cpp: whether to clear nothing. C++ clears only "obstacles", but the Jackal's layer is "obstacles_layer".
    """

    def __init__(self, name: str, side: float, like_cpp: bool = False):
        self.name, self.side, self._clears = name, side, not like_cpp

    def start(self, now: float, pose: Pose) -> None:
        """Begin at time `now` [s]. The behaviour has no state."""

    def step(
        self,
        now: float,
        pose: Pose,
        local_costmap: Costmap,
        global_costmap: Costmap,
        global_pose: Optional[Pose] = None,
    ) -> Optional[Tuple[float, float]]:
        """Clear the costmaps and return None: the behaviour ends within its first cycle.

        global_pose: pose in the global costmap's frame, or None if it equals `pose`.
        """
        if self._clears:
            global_costmap.clear_outside(global_pose or pose, self.side)
            local_costmap.clear_outside(pose, self.side)
        return None


class RotateRecovery:
    """Recovery that rotates once anticlockwise in place (rotate_recovery.cpp:93). Its limits are read only at start-up.

    As in C++, half a turn and a full turn count as reached within `tolerance`. A control rate below 20 Hz may skip
    these yaws, so the accumulated rotation counts, too. With like_cpp, an incomplete rotation goes on forever.
    """

    def __init__(
        self,
        name: str,
        planner: Dict[str, Any],
        sim_granularity: float = 0.017,
        like_cpp: bool = False,
    ):
        self.name = name
        self.acc = planner["acc_lim_theta"]
        self.fastest, self.slowest = planner["max_vel_theta"], planner["min_in_place_vel_theta"]
        self.tolerance = planner["yaw_goal_tolerance"]
        self.granularity = sim_granularity
        self._start = self._angle = self._turned = self._until = 0.0
        self._patience = math.inf if like_cpp else PATIENCE
        self._half = False

    def start(self, now: float, pose: Pose) -> None:
        """Record the yaw at which the rotation begins."""
        self._start = self._angle = pose[2]
        self._turned, self._half = 0.0, False
        self._until = now + self._patience * 2.0 * math.pi / max(self.fastest, 1e-3)

    def step(
        self,
        now: float,
        pose: Pose,
        local_costmap: Costmap,
        global_costmap: Costmap,
        global_pose: Optional[Pose] = None,
    ) -> Optional[Tuple[float, float]]:
        """Return the next command (0, w), or None when the rotation is complete, blocked or takes too long."""
        x, y, yaw = pose
        done = self._half and abs(angle_difference(self._angle, self._start)) <= self.tolerance
        self._turned += angle_difference(self._angle, yaw)
        if done or now > self._until or self._turned >= 2.0 * math.pi:
            return None
        self._angle = yaw
        if self._half:
            left = abs(angle_difference(yaw, self._start))
        else:
            to_half = abs(angle_difference(yaw, self._start + math.pi))
            left = math.pi + to_half
            self._half = to_half < self.tolerance or self._turned > math.pi
        ahead = 0.0
        while ahead < left:
            if local_costmap.footprint_cost(x, y, yaw + ahead) < 0.0:
                return None
            ahead += self.granularity
        w = math.sqrt(2.0 * self.acc * left)
        return 0.0, min(max(w, self.slowest), self.fastest)


Behaviour = Union[ClearCostmapRecovery, RotateRecovery]


def build(parameters: Dict[str, Any], like_cpp: bool = False) -> List[Behaviour]:
    """Return the behaviours in order, from a complete parameter tree. As in C++, it is read only at start-up.

    The default list omits rotations if `clearing_rotation_allowed` is False. A custom list is used unchanged
    (move_base.cpp, loadRecoveryBehaviors). like_cpp: behave like C++, which clears nothing on the Jackal.
    """
    listed = parameters["recovery_behaviors"]
    usual = listed == DEFAULT_RECOVERIES
    made: Dict[str, Behaviour] = {}
    behaviours = []
    for entry in listed:
        name, clears = entry["name"], entry["type"] == RECOVERY_TYPES[0]
        if usual and not clears and not parameters["clearing_rotation_allowed"]:
            continue
        if name not in made:
            own = parameters[name]
            made[name] = (
                ClearCostmapRecovery(name, own["reset_distance"], like_cpp)
                if clears
                else RotateRecovery(
                    name, parameters["TrajectoryPlannerROS"], own["sim_granularity"], like_cpp
                )
            )
        behaviours.append(made[name])
    return behaviours
