"""Critic "obstacle": the costs under the robot's outline and centre (ObstacleCostFunction).

bounds.py finds its bound: the cost at a few poses, the current one first. A fast robot's footprint
is enlarged.
"""

import math

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import NO_MARGIN, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.dwa.critics.critic import COLLIDES, Critic
from applr_ros1.planner.dwa.records import DWAScene
from applr_ros1.planner.dwa.samples import ground_speed
from applr_ros1.planner.sampling_planner import OBSTACLE_TERM, Record, Velocity

CRITIC = Critic(
    OBSTACLE_TERM._replace(
        name="obstacle", refusal="touches unknown space, or the edge of the local costmap"
    ),
    scale="occdist_scale",
    value="largest cost under outline and centre (`sum_scores`: the points' sum)",
    refuses="-6: outline off the map or on cost 254 or 255",
)


@kernel
def value(p: Record, scene: DWAScene, points: Data, velocity: Velocity) -> float:
    """Return the largest cost at any of the points (k, 3), or COLLIDES if one of them is illegal.

    With sum_scores, return the sum of all costs. The speed of the velocity enlarges the footprint.
    """
    speed = ground_speed(velocity.vx, velocity.vy)
    cells = scene.cells
    rows, columns = cells.shape
    scaled_footprint = np.empty_like(scene.footprint)
    scale_footprint(scene.footprint, footprint_scale(p, speed), scaled_footprint)
    outline = outline_of(scene, scaled_footprint)
    largest_cost = cost_sum = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        theta = points[i, 2]
        cell_x, cell_y = world_to_map(x, y, scene.ox, scene.oy, scene.resolution, columns, rows)
        if cell_x < 0:
            return COLLIDES
        cost = outline_cost(
            outline, x, y, math.cos(theta), math.sin(theta), cell_x, cell_y, NO_MARGIN
        )
        if cost < 0:
            return COLLIDES
        # The centre may lie on a lethal cell as long as the outline does not touch one, as in C++.
        cost = max(cost, int(cells[cell_y, cell_x]))
        largest_cost = max(largest_cost, cost)
        cost_sum += cost
    return float(cost_sum if p.sum_scores else largest_cost)


@kernel(error_model="numpy")
def footprint_scale(p: Record, speed: float) -> float:
    """Return the factor by which the footprint is enlarged at this speed [m/s]."""
    # ObstacleCostFunction::getScalingFactor: a fast robot needs more room for errors.
    if speed <= p.scaling_speed:
        return 1.0
    speed_share = (speed - p.scaling_speed) / (p.max_vel_trans - p.scaling_speed)
    return p.max_scaling_factor * speed_share + 1.0


@kernel
def scale_footprint(footprint: Data, scale: float, scaled_footprint: Data) -> None:
    """Write the vertices (n, 2), multiplied by `scale`, to `scaled_footprint`."""
    for i in range(footprint.shape[0]):
        scaled_footprint[i, 0] = footprint[i, 0] * scale
        scaled_footprint[i, 1] = footprint[i, 1] * scale
