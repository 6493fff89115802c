"""The part of the global plan that the robot follows now (LocalPlannerUtil). docs/planner_dwa.md section 2."""

import math
from typing import Optional, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.plan_cut import leading_far, within

Pose = Tuple[float, float, float]
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
        x, y, yaw = _transformed(self.poses[-1:], _inverse(frame))[0].tolist()
        return x, y, yaw

    def cut(self, x: float, y: float, limit: float, prune: bool, frame: Optional[Pose] = None) -> np.ndarray:
        """The poses (k, 3) within `limit` [m] of the robot at x, y [m] and the one beyond; in the costmap's frame.

        prune: without the leading ones that are 1 m or farther away; as many go from the front of the stored plan,
        even where the cut begins later. frame: pose (x, y, yaw) of the costmap's frame in the plan's, None if they are
        one.
        """
        in_plan = (x, y) if frame is None else _placed(x, y, frame)
        first, last = within(self.poses, in_plan[0], in_plan[1], limit)
        cut = _transformed(self.poses[first:last], _inverse(frame))
        if prune:
            far = leading_far(cut, x, y)
            cut = cut[far:]
            self.poses = self.poses[far:]
        return cut


def _placed(x, y, frame):
    fx, fy, yaw = frame
    c, s = math.cos(yaw), math.sin(yaw)
    return fx + x * c - y * s, fy + x * s + y * c


def _inverse(frame):
    """The pose of the plan's frame in the costmap's; None stands for the same frame."""
    if frame is None:
        return None
    x, y, yaw = frame
    c, s = math.cos(yaw), math.sin(yaw)
    return -x * c - y * s, x * s - y * c, -yaw


def _transformed(poses, frame):
    """The poses (n, 3) as they are, or moved by a pose; their angles go through quaternions and a matrix."""
    moved = poses.copy()
    if frame is not None:
        moved[:, 0], moved[:, 1] = _placed(poses[:, 0], poses[:, 1], frame)
    _through_matrix(moved[:, 2], 0.0 if frame is None else frame[2])
    return moved


@kernel
def _through_matrix(yaws, turn):
    """Turn the angles (n,) in place, on the way that tf takes: quaternion, matrix, quaternion."""
    for i in range(yaws.shape[0]):
        z = math.sin(yaws[i] / 2)
        w = math.cos(yaws[i] / 2)
        if turn != 0.0:
            tz = math.sin(turn / 2)
            tw = math.cos(turn / 2)
            z, w = tw * z + tz * w, tw * w - tz * z
        scale = 2 / (z * z + w * w)
        a = w * (z * scale)
        m = 1 - z * (z * scale)
        trace = m + m + 1.0
        if trace > 0:
            r = math.sqrt(trace + 1.0)
            w = r / 2
        else:
            r = math.sqrt(1.0 - m - m + 1.0)
        back = (a + a) * (0.5 / r)
        if trace > 0:
            z = back
        else:
            z, w = r / 2, back
        yaws[i] = math.atan2(2 * (w * z), w * w - z * z)
