"""The interface of a local planner to MoveBase: it follows a plan with velocity commands and tells when it is there.

Implemented by trajectory/local_planner.py and dwa/local_planner.py; factory.py chooses by base_local_planner, as
pluginlib does in C++. tests/planner/test_local_planner_contract.py checks that every planner keeps this contract.
"""

from __future__ import annotations

import abc
from typing import Any, Dict, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose

Command = Tuple[float, float]


class LocalPlanner(abc.ABC):
    """Made with the values by name of its server and of its static parameters.

    Time, pose, velocity and map are arguments; nothing is fetched. Angles are in rad, lengths in m. It keeps state
    between calls (the plan, latches, flags), all of which `reset` clears.

    Attributes:
        remembers_reached: whether a goal found reached stays so until the next plan or reconfigure, to be read by
            C++'s move_base in its next cycle; otherwise that asks anew in each cycle.
        goal_reached: whether the last compute_velocity found the goal reached.
        cropped_plan: (n, 3) x, y, yaw: the part of the plan that the last command followed, empty if there was none.
    """

    remembers_reached: bool = False
    goal_reached: bool
    cropped_plan: np.ndarray

    @abc.abstractmethod
    def set_plan(self, plan) -> None:
        """Follow this plan (n, 3) x, y, yaw from now on; n may be 0. goal_reached is cleared."""

    @abc.abstractmethod
    def compute_velocity(self, pose, twist, costmap, local_origin: Optional[Pose] = None) -> Tuple[bool, Command]:
        """(ok, (v, w)) for this cycle.

        Args:
            pose: (x, y, yaw) of the robot in the costmap's frame.
            twist: (v, w) as measured.
            costmap: with cells (ny, nx) uint8, origin (x, y), resolution and footprint (k, 2); it is not changed.
            local_origin: pose (x, y, yaw) of the costmap's frame in the plan's (localisation moves one against the
                other); None where they are one.

        Returns:
            ok False: no valid command, the velocity is zero. So for a pose or twist that is not finite, and without a
            plan. At the goal: True, zero velocity, and goal_reached is set.
        """

    @abc.abstractmethod
    def reconfigure(self, params: Dict[str, Any]) -> None:
        """Take over new values of the server by name. ValueError, one line, refuses them and changes nothing."""

    @abc.abstractmethod
    def reset(self) -> None:
        """As a new object (training episodes): no plan, no latch, no flag. Parameters stay."""

    def end_escape(self) -> None:
        """Choose among all velocities again, if it was backing out: the way back is blocked."""
        return  # a planner that does not back out has nothing to do

    def refusals(self, costmap) -> Dict[str, int]:
        """Why the last cycle's samples gave no command: how many there were, and how many each critic refused.

        Empty where there was a command, or nothing was sampled. costmap: as that cycle saw it.
        """
        return {}

    @property
    @abc.abstractmethod
    def local_plan(self) -> np.ndarray:
        """(k, 3) x, y, yaw: the points of the trajectory that was chosen; empty if none was."""

    @abc.abstractmethod
    def cost_cloud(self, costmap) -> np.ndarray:
        """(k, 7) float32: x, y, z, path, goal, obstacle, total cost of the last cycle's cells, for display."""

    def trajectory_cloud(self, costmap) -> np.ndarray:
        """(k, 5) float32: x, y, z, theta, cost of points of the last cycle's legal trajectories; empty without any."""
        return np.zeros((0, 5), np.float32)
