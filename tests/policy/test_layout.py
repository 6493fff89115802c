"""Tests of resampling scans to a policy's layout, compared with a simple implementation beam by
beam.
"""

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.policy.actor import load, save
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.layout import ANGLE_TOLERANCE_RAD, Layout, ObservationError
from applr_ros1.policy.methods import make
from tests.support.refusals import refused

PAPER = Layout()
# Bearing of the Jackal's last beam [rad].
WIDE = 2.3562
SCANNERS = {  # first and last angle, number of ranges
    "541": (-WIDE, WIDE, 541),
    "1081": (-WIDE, WIDE, 1081),
    "720, a little turned": (-2.34, 2.35, 720),
    "360, 0 to 2 pi": (0.0, 6.28319, 360),
    "a full turn and more": (-np.pi, 3.3, 1500),
    "clockwise": (WIDE, -WIDE, 541),
}


def plain(layout, ranges, first, step):
    """Return for each beam of the layout the smallest range in its sector, or the range nearest in
    angle.
    """
    angles = first + step * np.arange(len(ranges))
    half_sector = layout.step / 2
    beams = []
    for middle in layout.angle_min + layout.step * np.arange(layout.beams):
        offsets = normalize_angle_modulo(angles - middle)
        is_inside = (offsets >= -half_sector) & (offsets < half_sector)
        if is_inside.any():
            beams.append(np.fmin.reduce(ranges[is_inside]))
        else:
            beams.append(ranges[np.argmin(np.abs(offsets))])
    return np.array(beams, np.float32)


def scan_of(kind, seed=0):
    """Return random ranges of a kind of scanner, its first angle and the angle between ranges."""
    first, last, count = SCANNERS[kind]
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.1, 30.0, count).astype(np.float32)
    invalid = rng.random(count) < 0.3
    ranges[invalid] = rng.choice([np.inf, -np.inf, np.nan], invalid.sum())
    return ranges, first, (last - first) / (count - 1)


@pytest.mark.parametrize("kind", SCANNERS)
@pytest.mark.parametrize("layout", [PAPER, Layout(90, -2.3, 2.3, 3.0)], ids=["720", "90"])
def test_resampling_equals_the_reference_implementation(kind, layout):
    scan = scan_of(kind)
    np.testing.assert_array_equal(layout.resample(*scan), plain(layout, *scan))


def test_a_scan_with_the_layouts_geometry_is_unchanged():
    random_ranges, _, _ = scan_of("541", 1)
    ranges = random_ranges.repeat(2)[:720]
    # LaserScan has angles in single precision, which lie beside the borders of the sectors.
    first = np.float32(PAPER.angle_min)
    step = np.float32(PAPER.step)
    assert PAPER.resample(ranges, first, step).tobytes() == ranges.tobytes()
    assert PAPER.resample(ranges[::-1], -first, -step).tobytes() == ranges.tobytes()


@pytest.mark.parametrize("kind", SCANNERS)
def test_zero_ranges_of_older_drivers_count_as_nan(kind):
    ranges, first, step = scan_of(kind)
    with_zeros = np.where(np.isnan(ranges), np.float32(0.0), ranges)
    expected = PAPER.resample(ranges, first, step)
    np.testing.assert_array_equal(PAPER.resample(with_zeros, first, step), expected)


def test_a_single_zero_range_is_nan():
    ranges = np.ones(720)
    ranges[5] = 0.0
    assert np.isnan(PAPER.resample(ranges, PAPER.angle_min, PAPER.step)[5])


@pytest.mark.parametrize(
    ("count", "first", "last", "line"),
    [
        (541, -1.57, 1.57, "covers -1.570 to 1.570 rad: the policy needs -2.356"),
        (360, 0.0, 3.14, "covers 0.000 to 3.140 rad"),
        (720, -2.356 + 2 * ANGLE_TOLERANCE_RAD, 2.356, "covers -2.316 to"),
        (100, -np.pi, np.pi, "finer scanner"),
        (1, 0.0, 0.0, "no geometry"),
        (0, 0.0, 0.0, "no geometry"),
        (720, np.nan, np.nan, "no geometry"),
    ],
)
def test_a_scan_that_does_not_cover_the_layout_is_rejected(count, first, last, line):
    step = (last - first) / max(1, count - 1)
    refused(lambda: PAPER.resample(np.ones(count), first, step), line, kind=ObservationError)


def test_an_actor_has_its_own_layout(tmp_path):
    # An observation has 60 beams, the goal's angle and 8 parameters.
    layout = Layout(60, -1.5, 1.5, 3.0, 0.5)
    rng = np.random.default_rng(0)
    weights = {
        "0.weight": rng.normal(size=(8, 69)).astype(np.float32),
        "0.bias": np.zeros(8, np.float32),
    }
    save(tmp_path / "a.safetensors", weights, encoding=PaperEncoding(robots.JACKAL, layout=layout))
    assert load(tmp_path / "a.safetensors").layout == layout
    assert make(str(tmp_path / "a.safetensors")).layout == layout
    assert make("dwa").layout == PAPER
