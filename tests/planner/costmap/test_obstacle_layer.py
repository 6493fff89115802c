"""Tests of scan projection and the obstacle layer. test_costmap.py compares whole drives with
recordings.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.common.scan import LaserScan, PointCloud, Source, project
from applr_ros1.planner.costmap.grid import Geometry
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from tests.support.seeds import examples

INF = math.inf
ORIGIN = (0.0, 0.0, 0.0)
NO_BOUNDS = (1e30, 1e30, -1e30, -1e30)


def scan(ranges, pose=ORIGIN, increment=0.1, height=0.0):
    """Return a scan with limits of .1 and 30 m."""
    return LaserScan(
        stamp=0.0,
        angle_min=0.0,
        angle_increment=increment,
        range_min=0.1,
        range_max=30.0,
        ranges=np.array(ranges, np.float32),
        sensor_pose=pose,
        sensor_height=height,
    )


def distances(cloud):
    """Return the distances (n,) [m] of points from the origin, in the plane."""
    return np.hypot(cloud.points[:, 0], cloud.points[:, 1])


def layer_of(origin, source):
    """Return a layer of 100 x 100 cells with one source."""
    layer = ObstacleLayer("seen", ObstacleParameters(), (source,), 0)
    layer.match_size(Geometry(100, 100, 0.05, np.array(origin), False))
    return layer


def observe_point(layer, x, y):
    """Let a sensor at the origin see one point [m]."""
    cloud = PointCloud(ORIGIN, np.array([[x, y, 0.0]], np.float32))
    layer.buffers[0].add_cloud(cloud, 0.0)
    layer.update_bounds(NO_BOUNDS, ORIGIN, np.zeros((0, 2)))


def test_ranges_within_the_limits_are_kept():
    cloud = project(scan([0.05, 0.1, 29.99, 30.0, INF, -INF, math.nan, 5.0]))
    np.testing.assert_allclose(distances(cloud), [0.1, 29.99, 5.0], rtol=1e-6)


def test_a_scan_without_ranges_has_no_points():
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
    # tf rotates by a matrix of floats that it makes of the quaternion, one rounding after the
    # other.
    f = np.float32
    z = f(math.sin(0.5 * yaw))
    w = f(math.cos(0.5 * yaw))
    m00 = f(1) - f(f(f(2) * z) * z)
    m10 = f(f(f(2) * z) * w)
    for beam, distance in enumerate(ranges):
        # The point in the laser's frame is computed in double, and stored as float32.
        angle = beam * float(f(0.0065))
        px = f(float(f(distance)) * math.cos(angle))
        py = f(float(f(distance)) * math.sin(angle))
        point_x, point_y, point_z = cloud.points[beam]
        assert point_x == f(f(f(m00 * px) - f(m10 * py)) + f(x))
        assert point_y == f(f(f(m10 * px) + f(m00 * py)) + f(y))
        assert point_z == f(0.3)
    assert cloud.origin == (x, y, 0.3)


@pytest.mark.parametrize(
    ("x", "is_marked"),
    [
        (2.5, False),
        (np.nextafter(np.float32(2.5), np.float32(0.0)), True),
    ],
)
def test_a_point_at_obstacle_range_does_not_mark(x, is_marked):
    """obstacle_layer.cpp skips points whose squared distance is at least the squared range."""
    layer = layer_of((-2.0, -2.5), Source(obstacle_range=2.5))
    observe_point(layer, x, 0.0)
    assert layer.cells.any() == is_marked
