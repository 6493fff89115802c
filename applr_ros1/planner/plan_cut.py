"""The part of the global plan that lies around the robot, and what of its beginning is behind.

Called by both local planners. Rules: base_local_planner/goal_functions.cpp:77, 96.
"""

from __future__ import annotations

from typing import Any, Tuple

import numpy as np

from applr_ros1.common.kernels import kernel

NEAR = 1.0  # [m]: leading points of the plan that are not nearer than this are dropped


def half_size(costmap: Any) -> float:
    """The larger half [m] of the map's two sides."""
    ny, nx = costmap.cells.shape
    return max(nx * costmap.resolution / 2.0, ny * costmap.resolution / 2.0)


def cut_plan(plan: np.ndarray, x: float, y: float, limit: float, prune: bool) -> Tuple[np.ndarray, int]:
    """(cut (k, 3), dropped): the part of `plan` (n, 3) that a robot at x, y [m] follows.

    From the first point within `limit` [m] on, up to and including the first one beyond it. Pruned: without the
    leading points that are NEAR or farther away; that many (`dropped`) are also to go from the front of the stored
    plan, even where the cut begins later.
    """
    first, last = within(plan, x, y, limit)
    dropped = leading_far(plan[first:last], x, y) if prune else 0
    return plan[first + dropped : last].copy(), dropped


@kernel
def within(plan, x, y, limit):
    """(first, last) of the points that are kept: plan[first:last]."""
    n = plan.shape[0]
    first = 0
    while first < n and _squared_distance(plan, first, x, y) > limit * limit:
        first += 1
    last = first
    while last < n:
        last += 1
        if _squared_distance(plan, last - 1, x, y) > limit * limit:
            break
    return first, last


@kernel
def leading_far(plan, x, y):
    """How many of the first points are NEAR or farther away."""
    far = 0
    while far < plan.shape[0] and _squared_distance(plan, far, x, y) >= NEAR * NEAR:
        far += 1
    return far


@kernel
def _squared_distance(plan, i, x, y):
    dx = x - plan[i, 0]
    dy = y - plan[i, 1]
    return dx * dx + dy * dy
