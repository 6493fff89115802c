"""Tests of scan projection and the obstacle layer. test_costmap.py compares whole drives with
recordings.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.common.scan import LaserScan, PointCloud, Source, project
from applr_ros1.planner.costmap import obstacle_layer
from tests.support.seeds import examples

INF = math.inf


def scan(ranges, pose=(0.0, 0.0, 0.0), increment=0.1, range_max=30.0, height=0.0):
    return LaserScan(
        0.0, 0.0, increment, 0.1, range_max, np.array(ranges, np.float32), pose, height
    )


def test_ranges_within_the_limits_are_kept():
    kept = project(scan([0.05, 0.1, 29.99, 30.0, INF, -INF, math.nan, 5.0]))
    np.testing.assert_allclose(np.hypot(*kept.points.T[:2]), [0.1, 29.99, 5.0], rtol=1e-6)


def test_infinite_ranges_are_used_if_they_are_declared_valid():
    kept = project(scan([INF, -INF, math.nan, 5.0]), inf_is_valid=True)
    assert (len(kept.points), np.hypot(*kept.points[0, :2])) == (2, pytest.approx(30.0 - 0.0001))
    assert len(project(scan([], (1.0, 2.0, 3.0))).points) == 0


@given(
    st.lists(st.floats(0.125, 29.0, width=32), min_size=1, max_size=40),
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-7, 7),
)
@examples(100)
def test_projection_rounds_like_the_cpp_code(ranges, x, y, yaw):
    cloud = project(scan(ranges, (x, y, yaw), increment=0.0065, height=0.3))
    f = np.float32
    z = f(math.sin(0.5 * yaw))
    w = f(math.cos(0.5 * yaw))
    m00 = f(1) - f(f(f(2) * z) * z)
    m10 = f(f(f(2) * z) * w)
    for index, r in enumerate(ranges):
        angle = index * float(f(0.0065))
        px, py = f(float(f(r)) * math.cos(angle)), f(float(f(r)) * math.sin(angle))
        assert cloud.points[index, 0] == f(f(f(m00 * px) - f(m10 * py)) + f(x))
        assert cloud.points[index, 1] == f(f(f(m10 * px) + f(m00 * py)) + f(y))
        assert cloud.points[index, 2] == f(0.3)
    assert cloud.origin == (x, y, 0.3)


def test_integer_parameters_do_not_compile_a_new_kernel():
    known = []
    for numbers in ({}, {"obstacle_range": 2, "raytrace_range": 3, "clearing": 1}):
        layer = obstacle_layer.ObstacleLayer(
            100,
            100,
            0.05,
            (-2.5, -2.5),
            False,
            0,
            obstacle_layer.ObstacleParameters(),
            (Source(**numbers),),
        )
        layer.cloud = PointCloud((0.0, 0.0, 0.0), np.array([[1.02, 0.02, 0.0]], np.float32))
        layer.update_bounds((1e30, 1e30, -1e30, -1e30), (0.0, 0.0, 0.0), np.zeros((0, 2)))
        known.append(len(obstacle_layer._observe.signatures))
    assert known[0] == known[1]


@pytest.mark.parametrize(
    ("x", "marked"), [(2.5, False), (np.nextafter(np.float32(2.5), np.float32(0.0)), True)]
)
def test_a_point_at_obstacle_range_does_not_mark(x, marked):
    """obstacle_layer.cpp skips points whose squared distance is at least the squared range."""
    given = (
        100,
        100,
        0.05,
        (-2.0, -2.5),
        False,
        0,
        obstacle_layer.ObstacleParameters(),
        (Source(obstacle_range=2.5),),
    )
    layer = obstacle_layer.ObstacleLayer(*given)
    layer.cloud = PointCloud((0.0, 0.0, 0.0), np.array([[x, 0.0, 0.0]], np.float32))
    layer.update_bounds((1e30, 1e30, -1e30, -1e30), (0.0, 0.0, 0.0), np.zeros((0, 2)))
    assert layer.cells.any() == marked
