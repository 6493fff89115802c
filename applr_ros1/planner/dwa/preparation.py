"""What a cycle begins with: the pose as used, the targets of the four distance grids, and where their floods start.

docs/explanation/planner_dwa.md section 3.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.distance_grid import reset, start_at, start_at_plan
from applr_ros1.planner.dwa.generator import take_start
from applr_ros1.planner.dwa.records import ALIGNMENT, FRONT, GOAL, PATH


@kernel
def prepare(params, scratch, plan, x, y, yaw, vx, vy, w):
    """Take pose and velocity, and switch the nose-on-path critic, off near the plan's end; returns whether it is on.

    plan: (k, 2 or 3) [m], not empty. yaw and w have already gone through a quaternion.
    """
    p = params[0]
    start = scratch.start
    take_start(start, x, y, yaw, vx, vy, w)
    last = plan.shape[0] - 1
    dx = start[0] - plan[last, 0]
    dy = start[1] - plan[last, 1]
    ahead = p.forward_point_distance
    aligned = dx * dx + dy * dy > ahead * ahead * p.cheat_factor
    p.alignment_scale = p.path_scale if aligned else 0.0
    return aligned


@kernel
def begin_floods(p, grids, start, scene, aligned):
    """Reset the grids for the scene's costmap and put 0 where each flood begins. aligned: nose-on-path is on."""
    cells, ox, oy, resolution, _, _, plan, aligned_plan = scene
    distances, queues, ends, facts = grids
    stride = cells.shape[1] + 2
    reset(distances[PATH], ends[PATH], cells)
    ends[:] = 0
    distances[GOAL] = distances[PATH]
    distances[FRONT] = distances[PATH]
    facts[0] = 1
    facts[1] = PATH
    if not aligned:
        facts[1] = ALIGNMENT
        distances[ALIGNMENT] = distances[PATH]
        start_at_plan(
            distances[ALIGNMENT], queues[ALIGNMENT], ends[ALIGNMENT], cells, ox, oy, resolution, aligned_plan, True
        )
    goal_x, goal_y = start_at_plan(distances[PATH], queues[PATH], ends[PATH], cells, ox, oy, resolution, plan, True)
    if goal_x >= 0:
        start_at(distances[GOAL], queues[GOAL], ends[GOAL], (goal_y + 1) * stride + goal_x + 1)
    front = plan.copy()
    last = front.shape[0] - 1
    angle = math.atan2(plan[last, 1] - start[1], plan[last, 0] - start[0])
    front[last, 0] += p.forward_point_distance * math.cos(angle)
    front[last, 1] += p.forward_point_distance * math.sin(angle)
    start_at_plan(distances[FRONT], queues[FRONT], ends[FRONT], cells, ox, oy, resolution, front, False)
