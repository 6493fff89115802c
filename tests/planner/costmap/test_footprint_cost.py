"""Tests of the footprint cost near borders of cells, where rounding decides."""

import numpy as np
import pytest

from applr_ros1.planner.costmap.footprint_cost import (
    NO_MARGIN,
    UNSURE,
    Outline,
    line_offsets,
    outline_cost,
)

MARGIN = 0.01  # [cells]
COST = 7  # of each cell


@pytest.mark.parametrize(
    ("x", "y", "is_sure"),
    [
        (0.5, 0.5, True),
        (0.995, 0.5, False),
        (1.005, 0.5, False),
        (0.5, 0.995, False),
        (0.5, 1.005, False),
    ],
)
def test_a_vertex_beside_a_border_of_two_cells_makes_the_cost_unsure(x, y, is_sure):
    """The place (x, y) is in cells from the middle of a map whose origin is no multiple of them."""
    resolution = 0.05
    origin_x = -0.51
    origin_y = 0.33
    cells = np.full((20, 20), COST, np.uint8)
    # Whole cells away from the place, so that all vertices are as near to borders as it is
    footprint = resolution * np.array([[-3.0, -3.0], [-3.0, 3.0], [3.0, 3.0], [3.0, -3.0]])
    lines = line_offsets(footprint, resolution, 20)
    outline = Outline(cells, cells.ravel(), origin_x, origin_y, resolution, footprint, lines)
    pose = (origin_x + (10.0 + x) * resolution, origin_y + (10.0 + y) * resolution, 1.0, 0.0)

    cost = outline_cost.py_func(outline, *pose, 10, 10, MARGIN)
    exact_cost = outline_cost.py_func(outline, *pose, 10, 10, NO_MARGIN)

    assert cost == (COST if is_sure else UNSURE)
    assert exact_cost == COST
