"""Interface of the local planners to MoveBase: follow a plan and report a reached goal.

trajectory/local_planner.py and dwa/local_planner.py implement it. factory.py chooses by
base_local_planner, like pluginlib in C++. tests/planner/test_local_planner_contract.py checks every
planner against this contract.
"""

from __future__ import annotations

import abc
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist

NO_POSES = np.zeros((0, 3))


class LocalPlanner(abc.ABC):
    """Base class of the local planners.

    The constructor takes the server's and the static parameters as dicts. Time, pose, velocity and
    costmap are arguments, so a planner never fetches data itself. Angles are in rad, lengths in m.
    A planner keeps state between calls (plan, latches, flags), which `reset` clears.

    Attributes:
        remembers_reached: whether goal_reached stays True until the next plan or reconfigure. The
            C++ move_base reads this flag only in its next cycle. Planners that do not remember it
            test the goal again in every cycle.
        goal_reached: whether the last compute_velocity found the goal reached.
        is_turning: whether it turns the robot to the goal's heading, until this is reached.
        cropped_plan: part (n, 3) x, y, yaw of the plan that the last command followed, empty if
            there was none.
    """

    remembers_reached: bool = False
    goal_reached: bool
    is_turning: bool = False
    cropped_plan: np.ndarray
    _choice: Any = None  # choice among the samples of this cycle, if it drives one

    @abc.abstractmethod
    def set_plan(self, plan: np.ndarray) -> None:
        """Follow the plan (n, 3) x, y, yaw from now on and clear goal_reached. n may be 0."""

    @abc.abstractmethod
    def compute_velocity(
        self,
        pose: Sequence[float],
        twist: Sequence[float],
        costmap: Any,
        local_origin: Optional[Pose] = None,
    ) -> Tuple[bool, Twist]:
        """Return (ok, (v, w)) for this cycle.

        Args:
            pose: robot pose (x, y, yaw) in the costmap's frame.
            twist: measured velocity (v, w).
            costmap: map with cells (rows, columns) uint8, origin (x, y), resolution and footprint
                (k, 2). It is not modified.
            local_origin: pose (x, y, yaw) of the costmap's frame in the plan's frame, as corrected
                by localisation. None if both are the same frame.

        Returns:
            If there is no valid command, ok is False and the velocity zero. Examples are a pose or
            twist that is not finite, and a missing plan. At the goal, ok is True, the velocity zero
            and goal_reached set.
        """

    @abc.abstractmethod
    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply new values {name: value} of server parameters.

        Raises:
            ValueError: a value is invalid. Nothing is changed. The message has one line.
        """

    def end_escape(self) -> None:
        """Stop backing out and sample all velocities again, because the way back is blocked."""
        return  # Planners that never back out have nothing to do.

    def refusals(self, costmap: Any) -> Dict[str, int]:
        """Return why the last cycle's samples gave no command.

        These are their number, and how many each critic rejected. Empty if there was a command or
        nothing was sampled. `costmap` must be the one of that cycle.
        """
        return {}

    @property
    def local_plan(self) -> np.ndarray:
        """Points (k, 3) x, y, yaw of this cycle's trajectory.

        Empty if there is none, as while stopping or turning at the goal.
        """
        return NO_POSES if self._choice is None else self._choice.points

    @abc.abstractmethod
    def cost_cloud(self, costmap: Any) -> np.ndarray:
        """Return the costs of the last cycle's cells, for display.

        The result is (k, 7) float32: x, y, z, path, goal, obstacle and total cost.
        """

    def trajectory_cloud(self, costmap: Any) -> np.ndarray:
        """Return the points of the last cycle's legal trajectories, for display.

        The result is (k, 5) float32: x, y, z, theta, cost.
        """
        return np.zeros((0, 5), np.float32)
