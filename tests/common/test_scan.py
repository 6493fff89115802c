"""Tests of what the ranges of a laser mean."""

import numpy as np
import pytest

from applr_ros1.common.scan import LaserScan

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
