"""Recoveries of a move_base that is stuck: clear the maps away from the robot, or turn once in place and look.

MoveBase holds one object per behaviour and calls step() once per control turn until it says it is over, so a
rotation can be cancelled between two turns.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

from applr_ros1.common.angles import Pose
from applr_ros1.planner.parameters.move_base_parameters import DEFAULT_RECOVERIES, RECOVERY_TYPES
from applr_ros1.planner.sampling_planner import angle_difference

PATIENCE = 4.0  # a rotation that takes this many times its unhindered time is over (C++ would turn for ever)


class ClearCostmapRecovery:
    """Forgets obstacles outside a square of `side` metres about the robot, in both maps, global first.

    Unlike C++ it clears the obstacle layer whatever its name is. The last scan stays and marks again. like_cpp: it
    looks for a layer named "obstacles", does not find it (the Jackal's is "obstacles_layer"), and clears nothing.
    """

    def __init__(self, name: str, side: float, like_cpp: bool = False):
        self.name, self.side, self._clears = name, side, not like_cpp

    def start(self, now: float, pose: Pose) -> None:
        """Begin at time `now` [s]; nothing has to be remembered."""
        pass

    def step(
        self, now: float, pose: Pose, local_costmap, global_costmap, global_pose: Optional[Pose] = None
    ) -> Optional[Tuple[float, float]]:
        """Always None: over within its first turn. global_pose: in the global costmap's frame, None: as pose."""
        if self._clears:
            global_costmap.clear_outside(global_pose or pose, self.side)
            local_costmap.clear_outside(pose, self.side)
        return None


class RotateRecovery:
    """One turn anticlockwise in place (rotate_recovery.cpp:93). Its limits are read once.

    Half a turn and a whole one are noticed within `tolerance`, as in C++ at its 20 Hz, and also where a slower control
    rate steps across.
    like_cpp: a turn that does not come round goes on for ever.
    """

    def __init__(self, name: str, planner: dict, sim_granularity: float = 0.017, like_cpp: bool = False):
        self.name = name
        self.acc = planner["acc_lim_theta"]
        self.fastest, self.slowest = planner["max_vel_theta"], planner["min_in_place_vel_theta"]
        self.tolerance = planner["yaw_goal_tolerance"]
        self.granularity = sim_granularity
        self._start = self._angle = self._turned = self._until = 0.0
        self._patience = math.inf if like_cpp else PATIENCE
        self._half = False

    def start(self, now: float, pose: Pose) -> None:
        """Remember where the turn begins."""
        self._start = self._angle = pose[2]
        self._turned, self._half = 0.0, False
        self._until = now + self._patience * 2.0 * math.pi / max(self.fastest, 1e-3)

    def step(
        self, now: float, pose: Pose, local_costmap, global_costmap, global_pose: Optional[Pose] = None
    ) -> Optional[Tuple[float, float]]:
        """The next command (0, w); None when the turn is complete, blocked or takes too long."""
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


def build(parameters: dict, like_cpp: bool = False) -> list:
    """The behaviours in order, from a complete parameter tree. Read at start-up only, as in C++.

    The default ones have no rotations without `clearing_rotation_allowed`; a list given instead of them is taken as it
    is (move_base.cpp, loadRecoveryBehaviors). like_cpp: as the C++ behaviours, which clear nothing on the Jackal.
    """
    listed = parameters["recovery_behaviors"]
    usual = listed == DEFAULT_RECOVERIES
    made = {}
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
                else RotateRecovery(name, parameters["TrajectoryPlannerROS"], own["sim_granularity"], like_cpp)
            )
        behaviours.append(made[name])
    return behaviours
