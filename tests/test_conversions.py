"""Messages written in one piece equal the generated classes' byte for byte; scans and quaternions are judged."""

import io
import math
from types import SimpleNamespace

import genpy
import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import OccupancyGrid, Path
from sensor_msgs.msg import LaserScan

from applr_ros1.common import angles
from applr_ros1.nodes import conversions
from applr_ros1.nodes.conversions import MessageError

STAMP = genpy.Time(12, 345)


def written(message):
    buff = io.BytesIO()
    message.serialize(buff)
    return buff.getvalue()


def costmap(ny=6, nx=9):
    cells = np.random.default_rng(0).integers(0, 256, (ny, nx)).astype(np.uint8)
    cells[0, :4] = 0, 253, 254, 255
    return SimpleNamespace(cells=cells, size=(nx, ny), resolution=0.05, origin=np.array([-1.5, 2.0]))


def test_grid_equals_the_generated_message():
    prepared = conversions.grid(costmap(), "odom", STAMP)
    plain = prepared.message
    plain.data = [int(conversions.OCCUPANCY[c]) for c in costmap().cells.ravel()]
    assert plain.data[:4] == [0, 99, 100, -1]
    by_itself = written(plain)
    plain.data = []  # prepared writes what lies in its payload
    assert written(prepared) == by_itself
    back = OccupancyGrid().deserialize(by_itself)
    assert (back.info.width, back.info.height, back.info.origin.position.y) == (9, 6, 2.0)


def test_update_is_the_window():
    prepared = conversions.grid_update(costmap(), (2, 1, 5, 4), "odom", STAMP)
    message = prepared.message
    assert (message.x, message.y, message.width, message.height) == (2, 1, 3, 3)
    assert prepared.payload == conversions.OCCUPANCY[costmap().cells[1:4, 2:5]].tobytes()


@pytest.mark.parametrize("n", [0, 1, 50])
@pytest.mark.parametrize("frame", ["odom", "a_longer/frame"])
def test_path_equals_the_generated_message(n, frame):
    poses = np.random.default_rng(1).normal(size=(n, 3))
    plain = Path(header=conversions.header(frame, STAMP))
    plain.poses = [conversions.pose_stamped(p, frame, STAMP) for p in poses.tolist()]
    assert written(conversions.path(poses, frame, STAMP)) == written(plain)


def test_occupancy_of_every_cost():
    table = conversions.OCCUPANCY
    assert table[[0, 1, 2, 126, 252, 253, 254, 255]].tolist() == [0, 1, 1, 49, 98, 99, 100, -1]
    assert (np.diff(table[:255].astype(int)) >= 0).all()


@pytest.mark.parametrize(
    ("q", "upright"),
    [
        ((0, 0, 0, 1), True),
        ((0, 0, 1, 0), True),
        ((0, 0, 3, 4), True),
        ((0, 0, 0, 0), False),
        ((1, 0, 0, 0), False),
        ((0, 0, math.nan, 1), False),
        ((0, 0, math.inf, 1), False),
        ((0.03, 0, 0, 1), False),
        ((0.01, 0, 0, 1), True),
        ((0, 0, 1e-4, 1e-4), False),
    ],
)
def test_quaternions(q, upright):
    assert conversions.is_upright(Quaternion(*map(float, q))) is upright


def test_compose_and_yaw():
    x, y, yaw = angles.compose((1.0, 2.0, math.pi / 2), (1.0, 0.0, math.pi))
    assert (x, y) == pytest.approx((1.0, 3.0))
    assert yaw == pytest.approx(-math.pi / 2)
    q = conversions.pose_stamped((0, 0, -2.5), "odom", STAMP).pose.orientation
    assert angles.yaw_of(q) == pytest.approx(-2.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(ranges=[]), "0 beams"),
        (dict(ranges=[1.0] * 3), "3 beams where it had 4"),
        (dict(ranges=[math.nan] * 4), "all NaN"),
        (dict(angle_min=math.nan), "finite"),
        (dict(angle_increment=0.0), "increment"),
    ],
)
def test_scans_that_cannot_be_used(change, words):
    scan = LaserScan(angle_min=-1.0, angle_increment=0.5, range_min=0.1, range_max=30.0)
    scan.ranges = [1.0, 2.0, math.inf, math.nan]
    assert conversions.check_scan(scan, 4).dtype == np.float32
    for name, value in change.items():
        setattr(scan, name, value)
    with pytest.raises(MessageError, match=words):
        conversions.check_scan(scan, 4)
