"""The part of the global plan to follow now (LocalPlannerUtil). docs/explanation/planner_dwa.md section 2."""

from typing import Optional

import numpy as np

from applr_ros1.common.angles import Pose, inverse
from applr_ros1.planner.plan_cut import cut_plan, transformed

EMPTY = np.zeros((0, 3))


class LocalPlan:
    """The stored plan: cut anew in every cycle, and with `prune` shortened at the front for good."""

    def __init__(self):
        self.poses = EMPTY

    def set(self, plan: np.ndarray) -> None:
        """Take a plan (n, 3) x, y [m], yaw [rad], n may be 0."""
        self.poses = np.array(plan, dtype=np.float64, order="C").reshape(-1, 3)

    def goal(self, frame: Optional[Pose] = None) -> Optional[Pose]:
        """The last pose (x, y, yaw) of the plan in the costmap's frame, None without a plan. frame: see cut."""
        if len(self.poses) == 0:
            return None
        x, y, yaw = transformed(self.poses[-1:], None if frame is None else inverse(frame))[0].tolist()
        return x, y, yaw

    def cut(self, x: float, y: float, limit: float, prune: bool, frame: Optional[Pose] = None) -> np.ndarray:
        """The poses (k, 3) within `limit` [m] of the robot at x, y [m] and the one beyond; in the costmap's frame.

        prune: without the leading ones that are 1 m or farther away; as many go from the front of the stored plan,
        even where the cut begins later. frame: pose (x, y, yaw) of the costmap's frame in the plan's, None if they are
        one.
        """
        cut, dropped = cut_plan(self.poses, x, y, limit, prune, frame)
        self.poses = self.poses[dropped:]
        return cut if frame is not None else transformed(cut, None)  # C++ turns by the identity, too
