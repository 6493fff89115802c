"""Tests of what the ranges of a laser mean."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.scan import LaserScan, measured_ranges, moved

NAN = np.nan
INF = np.inf


@pytest.mark.parametrize(
    ("sent", "shown"),
    [
        (0.1, 0.1),  # The smallest range that is measured
        (9.9, 9.9),
        (10.0, INF),
        (65.533, INF),  # Some drivers publish a number for no return.
        (INF, INF),
        (0.05, -INF),
        (-INF, -INF),
        (0.0, NAN),
        (NAN, NAN),
    ],
)
def test_a_range_is_measured_free_too_near_or_unknown(sent, shown):
    scan = LaserScan(0.0, 0.0, 0.1, 0.1, 10.0, np.array([sent, 1.0]), (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(scan.distances, np.float32([shown, 1.0]))


def test_zero_is_unknown_although_a_driver_claims_to_measure_from_it_on():
    scan = LaserScan(0.0, 0.0, 0.1, 0.0, 10.0, np.array([0.0, 0.01]), (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(scan.distances, np.float32([NAN, 0.01]))


FAN = 0.1  # angle between two beams of a fan [rad]
TURN = 2 * np.pi / 10  # of a full turn of ten beams [rad]


@pytest.mark.parametrize(
    ("increment", "sent", "free", "shown"),
    [
        pytest.param(FAN, [3, 0, 0, 2], [3, 2, 2, 2], [3, NAN, NAN, 2], id="narrow"),
        pytest.param(FAN, [0, 3, 2, 0], [3, 3, 2, 2], [NAN, 3, 2, NAN], id="at the ends"),
        pytest.param(-FAN, [3, 0, 2], [3, 2, 2], [3, NAN, 2], id="clockwise"),
        pytest.param(FAN, [0, 0, 0], [INF] * 3, [INF] * 3, id="nothing returns"),
        pytest.param(0.6, [3, 0, 0, 2], [3, INF, INF, 2], [3, INF, INF, 2], id="wide"),
        pytest.param(FAN, [3, NAN, 0.05, 2], [3, NAN, -INF, 2], [3, NAN, -INF, 2], id="invalid"),
        pytest.param(
            TURN,
            [0, 3, *[1] * 7, 2],
            [2, 3, *[1] * 7, 2],
            [NAN, 3, *[1] * 7, 2],
            id="across the ends of a full turn",
        ),
        pytest.param(TURN, [0, 1, *[0] * 8], [INF, 1, *[INF] * 8], [INF, 1, *[INF] * 8], id="post"),
    ],
)
def test_no_return_of_a_driver_with_a_value_for_it_frees_what_the_returns_beside_it_free(
    increment, sent, free, shown
):
    ranges = measured_ranges(np.float32(sent), 0.0)
    scan = LaserScan(0.0, 0.0, increment, 0.1, 10.0, ranges, (0.0, 0.0, 0.0), no_return=0.0)
    np.testing.assert_array_equal(scan.free, np.float32(free))
    np.testing.assert_array_equal(scan.distances, np.float32(shown))
    other = replace(scan, no_return=None)
    np.testing.assert_array_equal(other.free, other.distances)
    assert np.isposinf(other.distances[ranges == INF]).all()


def test_what_a_scan_has_shown_is_computed_once_for_all_frames():
    scan = LaserScan(0.0, 0.0, 0.1, 0.1, 10.0, np.array([0.0, 1.0]), (1.0, 0.0, 0.0))
    distances = scan.distances
    in_parent = moved(scan, (2.0, 3.0, np.pi))
    assert in_parent.distances is distances
    np.testing.assert_allclose(in_parent.sensor_pose, (1.0, 3.0, np.pi))
    assert scan.sensor_pose == (1.0, 0.0, 0.0)
