"""Tests of message conversions: packed messages equal generated ones byte for byte, and invalid
inputs are refused.
"""

import io
import math
from types import SimpleNamespace

import genpy
import numpy as np
import pytest
from geometry_msgs.msg import Point32, Quaternion, Transform, Vector3
from nav_msgs.msg import MapMetaData, OccupancyGrid, Path
from sensor_msgs.msg import LaserScan, PointCloud, PointCloud2, PointField
from std_msgs.msg import Header

from applr_ros1.common.scan import project
from applr_ros1.nodes import conversions
from applr_ros1.nodes.conversions import MessageError
from tests.support.refusals import refused

STAMP = genpy.Time(12, 345)


def written(message):
    buff = io.BytesIO()
    message.serialize(buff)
    return buff.getvalue()


def costmap(ny=6, nx=9):
    cells = np.random.default_rng(0).integers(0, 256, (ny, nx)).astype(np.uint8)
    cells[0, :4] = 0, 253, 254, 255
    return SimpleNamespace(
        cells=cells, size=(nx, ny), resolution=0.05, origin=np.array([-1.5, 2.0])
    )


def test_grid_equals_the_generated_message():
    prepared = conversions.grid(costmap(), "odom", STAMP)
    plain = prepared.message
    plain.data = [int(conversions.OCCUPANCY[c]) for c in costmap().cells.ravel()]
    assert plain.data[:4] == [0, 99, 100, -1]
    by_itself = written(plain)
    plain.data = []  # `prepared` writes its payload instead.
    assert written(prepared) == by_itself
    back = OccupancyGrid().deserialize(by_itself)
    assert (back.info.width, back.info.height, back.info.origin.position.y) == (9, 6, 2.0)


def test_update_is_the_window():
    prepared = conversions.grid_update(costmap().cells[1:4, 2:5], (2, 1), "odom", STAMP)
    message = prepared.message
    assert (message.x, message.y, message.width, message.height) == (2, 1, 3, 3)
    assert prepared.payload == conversions.OCCUPANCY[costmap().cells[1:4, 2:5]].tobytes()


@pytest.mark.parametrize("n", [0, 50])
def test_path_equals_the_generated_message(n):
    frame = "a_longer/frame"
    poses = np.random.default_rng(1).normal(size=(n, 3))
    plain = Path(header=Header(0, STAMP, frame))
    plain.poses = [conversions.pose_stamped(p, frame, STAMP) for p in poses.tolist()]
    assert written(conversions.path(poses, frame, STAMP)) == written(plain)


@pytest.mark.parametrize(
    ("q", "upright"),
    [
        ((0, 0, 3, 4), True),
        ((0, 0, 0, 0), False),
        ((0, 0, math.nan, 1), False),
        ((0.03, 0, 0, 1), False),
        ((0.01, 0, 0, 1), True),
    ],
)
def test_only_upright_quaternions_are_accepted(q, upright):
    assert conversions.is_upright(Quaternion(*map(float, q))) is upright


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(ranges=[]), "0 beams"),
        (dict(ranges=[math.nan] * 4), "all NaN"),
        (dict(angle_min=math.nan), "finite"),
        (dict(angle_increment=0.0), "increment"),
    ],
)
def test_scans_that_cannot_be_used(change, words):
    scan = LaserScan(angle_min=-1.0, angle_increment=0.5, range_min=0.1, range_max=30.0)
    scan.ranges = [1.0, 2.0, math.inf, math.nan]
    assert conversions.check_scan(scan).dtype == np.float32
    for name, value in change.items():
        setattr(scan, name, value)
    refused(lambda: conversions.check_scan(scan), words, kind=MessageError)


def test_scans_of_a_laser_upside_down_or_tilted_have_the_true_points():
    """Three beams of a laser at (1, 2, 0.5) with a roll of pi and a yaw of 0.3, or with a pitch of
    0.2.
    """
    message = LaserScan(
        angle_min=-0.4, angle_increment=0.5, range_min=0.1, range_max=10.0, ranges=[1.0, 2.0, 3.0]
    )
    angles = -0.4 + 0.5 * np.arange(3)
    ranges = np.array([1.0, 2.0, 3.0], np.float32)
    place = Transform(Vector3(1.0, 2.0, 0.5), Quaternion(math.cos(0.15), math.sin(0.15), 0.0, 0.0))
    hanging = conversions.laser_scan(message, ranges, place)
    assert hanging.rotation is None
    assert hanging.sweep == 0.0
    message.time_increment = -0.01
    assert conversions.laser_scan(message, ranges, place).sweep == pytest.approx(0.02)
    points = sorted(project(hanging).points.tolist())
    expected = [
        (1.0 + r * math.cos(0.3 - a), 2.0 + r * math.sin(0.3 - a), 0.5)
        for r, a in zip(ranges, angles)
    ]
    np.testing.assert_allclose(points, sorted(expected), atol=1e-5)
    place.rotation = Quaternion(0.0, math.sin(0.1), 0.0, math.cos(0.1))
    points = project(conversions.laser_scan(message, ranges, place)).points
    np.testing.assert_allclose(
        points[:, 2], 0.5 - ranges * np.cos(angles) * math.sin(0.2), atol=1e-5
    )
    np.testing.assert_allclose(points[:, 1], 2.0 + ranges * np.sin(angles), atol=1e-5)


def test_points_of_clouds():
    """Fields may be in any order, rows padded, and bytes in either order. PointCloud is accepted,
    too.
    """
    kind = np.dtype(
        {"names": list("izxy"), "formats": [">f4"] * 4, "offsets": [0, 4, 12, 20], "itemsize": 24}
    )
    table = np.zeros((2, 3), kind)
    table["x"], table["y"], table["z"] = np.arange(6).reshape(2, 3), 10.0, -1.5
    rows = b"".join(row.tobytes() + b"pad" for row in table)
    message = PointCloud2(
        height=2, width=3, point_step=24, row_step=75, is_bigendian=True, data=rows
    )
    message.fields = [
        PointField(name, offset, PointField.FLOAT32, 1) for name, offset in zip("zxy", (4, 12, 20))
    ]
    points = conversions.points_of(message)
    np.testing.assert_array_equal(points, [(k, 10.0, -1.5) for k in range(6)])
    np.testing.assert_array_equal(
        conversions.points_of(PointCloud(points=[Point32(1.0, 2.0, 3.0)])), [(1.0, 2.0, 3.0)]
    )
    message.fields = message.fields[:2]
    with pytest.raises(MessageError, match="give x, y and z as FLOAT32"):
        conversions.points_of(message)
    # A cloud without points needs no fields.
    assert conversions.points_of(PointCloud2()).shape == (
        0,
        3,
    )


def test_maps_are_converted_and_rotated_or_incomplete_ones_refused():
    message = OccupancyGrid(data=[0, 100, -1, 50, 0, 0])
    message.header.frame_id = "/map"
    message.info.width = 3
    message.info.height = 2
    message.info.resolution = 0.05
    static_map = conversions.static_map(message)
    assert (static_map.cells.tolist(), static_map.frame, static_map.origin) == (
        [[0, 100, -1], [50, 0, 0]],
        "map",
        (0.0, 0.0),
    )
    message.info.origin.orientation.z = 1.0
    refused(
        lambda: conversions.static_map(message),
        "a yaw of 3.14 rad: give an origin without yaw",
        kind=MessageError,
    )
    with pytest.raises(MessageError, match="has 6 cells for 4 x 2"):
        conversions.static_map(
            OccupancyGrid(data=message.data, info=MapMetaData(width=4, height=2))
        )


def test_a_drivers_range_for_no_return_becomes_infinity():
    scan = LaserScan(ranges=[0.0, 1.0, math.inf, 2.0], angle_increment=0.1)
    assert conversions.check_scan(scan, 0.0).tolist() == [math.inf, 1.0, math.inf, 2.0]
    assert conversions.check_scan(scan).tolist() == [0.0, 1.0, math.inf, 2.0]


def test_range_max_may_be_infinite_but_not_nan():
    """pointcloud_to_laserscan publishes an infinite range_max, and laser_geometry accepts it."""
    scan = LaserScan(
        angle_increment=0.5, range_min=0.1, range_max=math.inf, ranges=[2.0, math.inf, 3.0]
    )
    for valid in (False, True):
        level = Transform(rotation=Quaternion(0.0, 0.0, 0.0, 1.0))
        planners = conversions.laser_scan(scan, conversions.check_scan(scan), level)
        points = project(planners, valid).points
        assert len(points) == 2
    scan.range_max = math.nan
    refused(lambda: conversions.check_scan(scan), "finite", kind=MessageError)
