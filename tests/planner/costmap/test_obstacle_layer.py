"""Scan projection and the obstacle layer by hand: ranges, heights, clearing, marking, recovery's clearing.

Whole drives against the plain version are in test_costmap.py.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from applr_ros1.planner.costmap.scan import LaserScan, PointCloud, Source, project

INF = math.inf
NOWHERE = (1e30, 1e30, -1e30, -1e30)
NO_FOOTPRINT = np.zeros((0, 2))


def scan(ranges, pose=(0.0, 0.0, 0.0), increment=0.1, range_max=30.0, height=0.0):
    return LaserScan(0.0, 0.0, increment, 0.1, range_max, np.array(ranges, np.float32), pose, height)


def layer(n=100, res=0.05, origin=(-2.5, -2.5), default=0, layer=None, **source):
    """layer: settings of the layer by name; all others are those of its one source."""
    return ObstacleLayer(n, n, res, origin, False, default, ObstacleParameters(**layer or {}), (Source(**source),))


def cloud(*points, origin=(0.0, 0.0, 0.0)):
    return PointCloud(origin, np.array(points, np.float32).reshape(-1, 3))


def observe(made, seen, pose=(0.0, 0.0, 0.0), footprint=NO_FOOTPRINT):
    made.cloud = seen
    return made.update_bounds(NOWHERE, pose, footprint)


def cell(made, x, y):
    return tuple(int((v - o) / made.resolution) for v, o in ((y, made.origin[1]), (x, made.origin[0])))


# -- scan to points ---------------------------------------------------------------------------------------------------
def test_what_is_kept():
    kept = project(scan([0.05, 0.1, 29.99, 30.0, INF, -INF, math.nan, 5.0]))
    np.testing.assert_allclose(np.hypot(*kept.points.T[:2]), [0.1, 29.99, 5.0], rtol=1e-6)


def test_infinite_ranges_count_when_they_are_declared_valid():
    kept = project(scan([INF, -INF, math.nan, 5.0]), inf_is_valid=True)
    assert len(kept.points) == 2
    assert np.hypot(*kept.points[0, :2]) == pytest.approx(30.0 - 0.0001)
    assert len(project(scan([], (1.0, 2.0, 3.0))).points) == 0


@given(
    st.lists(st.floats(0.125, 29.0, width=32), min_size=1, max_size=40),
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-7, 7),
)
@settings(max_examples=100, deadline=None)
def test_projection_rounds_as_the_cpp_code(ranges, x, y, yaw):
    made = project(scan(ranges, (x, y, yaw), increment=0.0065, height=0.3))
    f = np.float32
    z, w = f(math.sin(0.5 * yaw)), f(math.cos(0.5 * yaw))
    m00, m10 = f(1) - f(f(f(2) * z) * z), f(f(f(2) * z) * w)
    for i, r in enumerate(ranges):
        angle = i * float(f(0.0065))
        px, py = f(float(f(r)) * math.cos(angle)), f(float(f(r)) * math.sin(angle))
        assert made.points[i, 0] == f(f(f(m00 * px) - f(m10 * py)) + f(x))
        assert made.points[i, 1] == f(f(f(m10 * px) + f(m00 * py)) + f(y))
        assert made.points[i, 2] == f(0.3)
    assert made.origin == (x, y, 0.3)


# -- marking and clearing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "cleared", "marked"),
    [
        (0.5, True, True),
        (1.5, True, False),
        (2.5, False, False),
        (-1.0, False, False),
        (2.0, True, False),
        (1.0, True, True),
    ],
)
def test_heights(height, cleared, marked):
    made = layer(default=255, layer={"max_obstacle_height": 1.0}, min_obstacle_height=-0.5)
    observe(made, cloud((1.02, 0.02, height)))
    assert (made.cells[cell(made, 0.5, 0.01)] == 0) == cleared
    assert (made.cells[cell(made, 1.02, 0.02)] == 254) == marked


def test_marking_or_clearing_alone():
    made = layer(default=255, clearing=False)
    observe(made, cloud((1.02, 0.02, 0.0)))
    assert np.count_nonzero(made.cells != 255) == 1
    made = layer(default=255, marking=False)
    observe(made, cloud((1.02, 0.02, 0.0)))
    assert np.count_nonzero(made.cells == 0) == 21
    assert not (made.cells == 254).any()


def test_a_sensor_off_the_map_clears_nothing():
    made = layer(default=255)
    bounds = observe(made, cloud((0.0, 0.0, 0.0), origin=(-3.0, 0.0, 0.0)), (0.0, 0.0, 0.0))
    assert not (made.cells == 0).any()
    assert bounds == NOWHERE  # the hit is 3 m away and does not mark


def test_no_scan_no_bounds():
    assert layer().update_bounds(NOWHERE, (0.0, 0.0, 0.0), NO_FOOTPRINT) == NOWHERE
    square = np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]])
    assert layer().update_bounds(NOWHERE, (1.0, 0.0, 0.0), square) == (0.8, -0.1, 1.2, 0.1)
    assert layer(layer={"footprint_clearing_enabled": False}).update_bounds(NOWHERE, (1.0, 0.0, 0.0), square) == NOWHERE


def test_whole_numbers_as_parameters_compile_nothing_new():
    from applr_ros1.planner.costmap import obstacle_layer

    observe(layer(), cloud((1.02, 0.02, 0.0)))
    known = len(obstacle_layer._observe.signatures)
    observe(layer(obstacle_range=2, raytrace_range=3, clearing=1), cloud((1.02, 0.02, 0.0)))
    assert len(obstacle_layer._observe.signatures) == known


# -- recovery ---------------------------------------------------------------------------------------------------------


def test_clearing_outside_makes_the_whole_map_due_once():
    made = layer(n=40, origin=(-1.0, -1.0))
    made.clear_outside((0.0, 0.0, 0.0), 0.5)
    made.clear_outside((0.3, 0.0, 0.0), 0.5)
    np.testing.assert_allclose(made.update_bounds(NOWHERE, (0.0, 0.0, 0.0), NO_FOOTPRINT), (-1.0, -1.0, 0.975, 0.975))
    assert made.update_bounds(NOWHERE, (0.0, 0.0, 0.0), NO_FOOTPRINT) == NOWHERE
