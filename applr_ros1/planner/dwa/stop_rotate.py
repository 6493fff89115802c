"""Stops the robot at the goal's place and turns it to the goal's heading (LatchedStopRotateController).

Called by local_planner.py. docs/explanation/planner_dwa.md section 8. All angles have gone through a quaternion.
"""

import math
from typing import Any, Mapping, Tuple

import numpy as np

from applr_ros1.planner.angles import angle_difference, normalize_angle

STOPPING, TURNING, TURNED = "stopping", "turning", "turned"
Triple = Tuple[float, float, float]
STANDING = (0.0, 0.0, 0.0)
LIMITS = ("acc_lim_x", "acc_lim_y", "acc_lim_theta")


class StopRotate:
    """params: values of the DWAPlannerROS server by name, in force from now on. period [s]: the control period.

    latches: the goal's place, once reached, stays reached until the next plan.
    """

    def __init__(self, params: Mapping[str, Any], period: float, latches: bool):
        self._period, self._latches = period, latches
        self.reconfigure(params)
        self.reset()

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Take over the server's values by name."""
        self._params = params
        self._acceleration = [float(np.float32(params[name])) for name in LIMITS]

    def reset(self) -> None:
        """As new. Only this ends a turn that was begun before the goal's heading is reached: no plan or goal does."""
        self.rotating = False
        self.latched = False

    def new_plan(self) -> None:
        """The goal's place has to be reached anew."""
        self.latched = False

    def is_position_reached(self, pose: Triple, goal: Triple) -> bool:
        """Whether the robot at `pose` is within xy_goal_tolerance of `goal`, both (x, y, yaw); sets the latch."""
        if self._latches and self.latched:
            return True
        if np.hypot(goal[0] - pose[0], goal[1] - pose[1]) <= self._params["xy_goal_tolerance"]:
            self.latched = True
            return True
        return False

    def is_goal_reached(self, pose: Triple, velocity: Triple, goal: Triple) -> bool:
        """Whether place and heading are reached and the robot stands. velocity: vx, vy [m/s], w [rad/s] as measured."""
        return self.is_position_reached(pose, goal) and self._is_turned(pose, goal) and self.is_stopped(velocity)

    def _is_turned(self, pose, goal):
        return abs(angle_difference(pose[2], goal[2])) <= self._params["yaw_goal_tolerance"]

    def is_stopped(self, velocity: Triple) -> bool:
        """Whether the measured velocity counts as standing."""
        vx, vy, w = velocity
        slow = self._params["trans_stopped_vel"]
        return abs(w) <= self._params["theta_stopped_vel"] and abs(vx) <= slow and abs(vy) <= slow

    def command(self, pose: Triple, velocity: Triple, goal: Triple) -> Tuple[str, Triple]:
        """(phase, (vx, vy, w)) at the goal's place: STOPPING first, then TURNING, then TURNED with nothing to do.

        velocity: as measured, its w through a quaternion for the arithmetic but not for the question whether it stands.
        """
        if self._is_turned(pose, goal):
            self.rotating = False
            return TURNED, STANDING
        vx, vy, w = velocity[0], velocity[1], normalize_angle(velocity[2])
        if not self.rotating and not self.is_stopped(velocity):
            return STOPPING, self._slower((vx, vy, w))
        self.rotating = True
        return TURNING, (0.0, 0.0, self._turn(angle_difference(pose[2], goal[2]), w))

    def _slower(self, velocity):
        """The velocity after one period of braking as hard as the acceleration limits allow."""
        return tuple(
            (-1.0 if v < 0 else 1.0) * max(0.0, abs(v) - limit * self._period)
            for v, limit in zip(velocity, self._acceleration)
        )

    def _turn(self, error, w):
        """Turn rate [rad/s] that takes `error` [rad] away, no faster than the turn can be ended there."""
        limit = self._acceleration[2]
        change = limit * self._period
        speed = min(max(self._clamped(abs(error)), abs(w) - change), abs(w) + change)
        speed = self._clamped(min(math.sqrt(float(np.float32(2.0 * limit)) * abs(error)), speed))
        return -speed if error < 0 else speed

    def _clamped(self, w):
        return min(self._params["max_vel_theta"], max(self._params["min_vel_theta"], w))
