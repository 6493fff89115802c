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
    """Return the bytes of a message."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def costmap(rows=6, columns=9):
    """Return a costmap of random costs; the first four are free, inscribed, lethal and unknown."""
    cells = np.random.default_rng(0).integers(0, 256, (rows, columns)).astype(np.uint8)
    cells[0, :4] = 0, 253, 254, 255
    return SimpleNamespace(
        cells=cells, size=(columns, rows), resolution=0.05, origin=np.array([-1.5, 2.0])
    )


def test_grid_equals_the_generated_message():
    packed = conversions.grid(costmap(), "odom", STAMP)
    message = packed.message
    message.data = conversions.OCCUPANCY[costmap().cells.ravel()].tolist()
    assert message.data[:4] == [0, 99, 100, -1]
    generated_bytes = written(message)
    message.data = []  # `packed` writes its payload instead.
    assert written(packed) == generated_bytes
    grid = OccupancyGrid().deserialize(generated_bytes)
    assert grid.info.width == 9
    assert grid.info.height == 6
    assert grid.info.origin.position.y == 2.0


def test_update_is_the_window():
    window_cells = costmap().cells[1:4, 2:5]
    packed = conversions.grid_update(window_cells, (2, 1), "odom", STAMP)
    message = packed.message
    assert (message.x, message.y, message.width, message.height) == (2, 1, 3, 3)
    assert packed.payload == conversions.OCCUPANCY[window_cells].tobytes()


@pytest.mark.parametrize("count", [0, 50])
def test_path_equals_the_generated_message(count):
    frame = "a_longer/frame"
    poses = np.random.default_rng(1).normal(size=(count, 3))
    message = Path(header=Header(0, STAMP, frame))
    message.poses = [conversions.pose_stamped(pose, frame, STAMP) for pose in poses.tolist()]
    assert written(conversions.path(poses, frame, STAMP)) == written(message)


def test_a_command_has_a_forward_speed_and_a_turn_rate_only():
    message = conversions.twist(0.5, -0.3)
    assert message.linear == Vector3(0.5, 0.0, 0.0)
    assert message.angular == Vector3(0.0, 0.0, -0.3)


@pytest.mark.parametrize(
    ("quaternion", "upright"),
    [
        ((0, 0, 3, 4), True),
        ((0, 0, 0, 0), False),
        ((0, 0, math.nan, 1), False),
        ((0.03, 0, 0, 1), False),
        ((0.01, 0, 0, 1), True),
    ],
)
def test_only_upright_quaternions_are_accepted(quaternion, upright):
    assert conversions.is_upright(Quaternion(*map(float, quaternion))) is upright


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (dict(ranges=[]), "0 beams"),
        (dict(ranges=[math.nan] * 4), "all NaN"),
        (dict(angle_min=math.nan), "finite"),
        (dict(angle_increment=0.0), "increment"),
    ],
)
def test_scans_that_cannot_be_used(change, problem):
    scan = LaserScan(angle_min=-1.0, angle_increment=0.5, range_min=0.1, range_max=30.0)
    scan.ranges = [1.0, 2.0, math.inf, math.nan]
    assert conversions.check_scan(scan).dtype == np.float32
    for field, wrong_value in change.items():
        setattr(scan, field, wrong_value)
    refused(lambda: conversions.check_scan(scan), problem, kind=MessageError)


def test_scans_of_a_laser_upside_down_or_tilted_have_the_true_points():
    """Three beams of a laser at (1, 2, 0.5) with a roll of pi and a yaw of 0.3, or with a pitch of
    0.2.
    """
    message = LaserScan(
        angle_min=-0.4, angle_increment=0.5, range_min=0.1, range_max=10.0, ranges=[1.0, 2.0, 3.0]
    )
    angles = -0.4 + 0.5 * np.arange(3)
    ranges = np.array([1.0, 2.0, 3.0], np.float32)

    # Upside down, the beams are taken in reverse, and the sensor counts as level.
    upside_down = Quaternion(math.cos(0.15), math.sin(0.15), 0.0, 0.0)
    mounting = Transform(Vector3(1.0, 2.0, 0.5), upside_down)
    hanging_scan = conversions.laser_scan(message, ranges, mounting)
    assert hanging_scan.rotation is None
    assert hanging_scan.sweep == 0.0
    message.time_increment = -0.01
    assert conversions.laser_scan(message, ranges, mounting).sweep == pytest.approx(0.02)
    # Their order does not matter.
    points = sorted(project(hanging_scan).points.tolist())
    x = 1.0 + ranges * np.cos(0.3 - angles)
    y = 2.0 + ranges * np.sin(0.3 - angles)
    expected_points = np.column_stack([x, y, np.full(3, 0.5)])
    np.testing.assert_allclose(points, sorted(expected_points.tolist()), atol=1e-5)

    # Pitched down, the points ahead are lower, and their lateral positions as before.
    mounting.rotation = Quaternion(0.0, math.sin(0.1), 0.0, math.cos(0.1))
    points = project(conversions.laser_scan(message, ranges, mounting)).points
    heights = 0.5 - ranges * np.cos(angles) * math.sin(0.2)
    np.testing.assert_allclose(points[:, 2], heights, atol=1e-5)
    np.testing.assert_allclose(points[:, 1], 2.0 + ranges * np.sin(angles), atol=1e-5)


def test_points_of_clouds():
    """Fields may be in any order, rows padded, and bytes in either order. PointCloud is accepted,
    too.
    """
    # Six points in two rows; each point has 24 bytes with gaps, and each row ends with 3 more.
    layout = {"names": list("izxy"), "formats": [">f4"] * 4, "offsets": [0, 4, 12, 20]}
    cloud_rows = np.zeros((2, 3), np.dtype({**layout, "itemsize": 24}))
    cloud_rows["x"] = np.arange(6).reshape(2, 3)
    cloud_rows["y"] = 10.0
    cloud_rows["z"] = -1.5
    padded_bytes = b"".join(cloud_row.tobytes() + b"pad" for cloud_row in cloud_rows)
    message = PointCloud2(
        height=2, width=3, point_step=24, row_step=75, is_bigendian=True, data=padded_bytes
    )
    for field, offset in (("z", 4), ("x", 12), ("y", 20)):
        message.fields.append(PointField(field, offset, PointField.FLOAT32, 1))
    expected_points = np.column_stack([np.arange(6), np.full(6, 10.0), np.full(6, -1.5)])
    np.testing.assert_array_equal(conversions.points_of(message), expected_points)

    older_cloud = PointCloud(points=[Point32(1.0, 2.0, 3.0)])
    np.testing.assert_array_equal(conversions.points_of(older_cloud), [(1.0, 2.0, 3.0)])

    # Without y it is refused; a cloud without points needs no fields.
    message.fields = message.fields[:2]
    with pytest.raises(MessageError, match="give x, y and z as FLOAT32"):
        conversions.points_of(message)
    assert conversions.points_of(PointCloud2()).shape == (0, 3)


def test_maps_are_converted_and_rotated_or_incomplete_ones_refused():
    message = OccupancyGrid(data=[0, 100, -1, 50, 0, 0])
    message.header.frame_id = "/map"
    message.info.width = 3
    message.info.height = 2
    message.info.resolution = 0.05
    static_map = conversions.static_map(message)
    assert static_map.cells.tolist() == [[0, 100, -1], [50, 0, 0]]
    assert static_map.frame == "map"
    assert static_map.origin == (0.0, 0.0)

    message.info.origin.orientation.z = 1.0
    problem = "a yaw of 3.14 rad: give an origin without yaw"
    refused(lambda: conversions.static_map(message), problem, kind=MessageError)
    incomplete = OccupancyGrid(data=message.data, info=MapMetaData(width=4, height=2))
    with pytest.raises(MessageError, match="has 6 cells for 4 x 2"):
        conversions.static_map(incomplete)


def test_a_drivers_range_for_no_return_becomes_infinity():
    scan = LaserScan(ranges=[0.0, 1.0, math.inf, 2.0], angle_increment=0.1)
    assert conversions.check_scan(scan, 0.0).tolist() == [math.inf, 1.0, math.inf, 2.0]
    assert conversions.check_scan(scan).tolist() == [0.0, 1.0, math.inf, 2.0]


def test_range_max_may_be_infinite_but_not_nan():
    """pointcloud_to_laserscan publishes an infinite range_max, and laser_geometry accepts it."""
    scan = LaserScan(
        angle_increment=0.5, range_min=0.1, range_max=math.inf, ranges=[2.0, math.inf, 3.0]
    )
    level = Transform(rotation=Quaternion(0.0, 0.0, 0.0, 1.0))
    # Whether infinite ranges clear (inf_is_valid), they are no points here.
    for inf_is_valid in (False, True):
        converted = conversions.laser_scan(scan, conversions.check_scan(scan), level)
        assert len(project(converted, inf_is_valid).points) == 2
    scan.range_max = math.nan
    refused(lambda: conversions.check_scan(scan), "finite", kind=MessageError)
