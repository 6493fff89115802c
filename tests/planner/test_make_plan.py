"""Tests of the service make_plan: the square that it frees, and the points that it tries near an
unreachable goal.
"""

import math

import numpy as np
import pytest

from applr_ros1.planner.make_plan import reachable_near
from applr_ros1.planner.move_base import MoveBase
from tests.support.robots import quick
from tests.support.scenes import laser_costmap


@pytest.mark.parametrize(
    ("tolerance", "step", "count"),
    [
        # Squares are three cells of 0.1 m apart: two fit, of 8 and 16 points.
        (0.7, 0.3, 24),
        # A smaller tolerance is the step.
        (0.2, 0.2, 8),
    ],
)
def test_points_near_the_goal_come_in_the_order_of_cpp(tolerance, step, count):
    """planService in move_base.cpp: the squares grow, y is the outer loop, below comes first."""
    costmap = laser_costmap(6, 6, 0.1, (-3.0, -3.0))
    goal = (0.05, 0.05, 0.0)
    points = reachable_near(costmap, (-1.0, 0.0), goal, tolerance, True)
    offsets = np.round((points - goal[:2]) / step).astype(int).tolist()
    assert offsets[:8] == [[-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [1, -1], [-1, 1], [1, 1]]
    beginning_of_second = [[-2, 0], [2, 0], [-2, -1], [2, -1], [-2, 1], [2, 1], [0, -2], [0, 2]]
    assert offsets[8:16] == (beginning_of_second if count == 24 else [])

    # Around a robot in unknown space, only a plan through it reaches a point.
    costmap.cells[:] = 255
    assert len(reachable_near(costmap, (-1.0, 0.0), goal, tolerance, True)) == count
    assert len(reachable_near(costmap, (-1.0, 0.0), goal, tolerance, False)) == 0


def freed_square(costmap):
    """Return the lower left and the upper right corner (2, 2) of the free cells [m]."""
    cells = np.argwhere(costmap.cells.T == 0)
    corners = np.array([cells.min(axis=0), cells.max(axis=0) + 1])
    return costmap.origin + costmap.resolution * corners


@pytest.mark.parametrize("frees", [True, False])
def test_make_plan_frees_a_square_around_the_robot_in_both_costmaps(frees):
    # Given: maps full of obstacles, and a robot in two frames
    move_base = MoveBase(quick(make_plan_clear_costmap=frees, clearing_radius=0.28))
    local_origin = (2.0, 1.0, 0.5 * math.pi)  # pose of the odometry's frame in the map's
    local_pose = (1.0, 0.0, 0.0)
    move_base.step(0.0, local_pose, (0.0, 0.0), local_origin=local_origin)
    for costmap in move_base.costmaps.values():
        costmap.cells[:] = 254

    # When: a plan is asked for
    global_pose = move_base.in_global_frame(local_pose)
    move_base.make_plan(global_pose, (5.0, 5.0, 0.0))

    # Then: cells within clearing_radius of the robot are free in each map
    if frees:
        for costmap, centre in (
            (move_base.local_costmap, (1.0, 0.0)),
            (move_base.global_costmap, (2.0, 2.0)),
        ):
            # Cells that the square touches are free, too.
            expected = np.add(centre, [[-0.28], [0.28]])
            assert freed_square(costmap) == pytest.approx(expected, abs=costmap.resolution)
    else:
        assert move_base.local_costmap.cells.all()
        # navfn frees the cell of the robot's centre.
        assert np.count_nonzero(move_base.global_costmap.cells == 0) == 1
