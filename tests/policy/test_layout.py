"""Tests of resampling scans to a policy's layout, compared with a simple implementation beam by
beam.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.policy.actor import load, save
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.encoding import PaperEncoding
from applr_ros1.policy.layout import ANGLE_TOLERANCE_RAD, Layout, ObservationError
from applr_ros1.policy.methods import make
from applr_ros1.policy.observation import layout_of
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


class Scan(NamedTuple):
    """Ranges (n,) float32 [m], first angle and angle between two ranges [rad]."""

    ranges: np.ndarray
    first: float
    step: float


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
    """Return a random Scan of a kind of scanner, with 30 % invalid ranges."""
    first_angle, last_angle, beam_count = SCANNERS[kind]
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.1, 30.0, beam_count).astype(np.float32)
    is_invalid = rng.random(beam_count) < 0.3
    ranges[is_invalid] = rng.choice([np.inf, -np.inf, np.nan], is_invalid.sum())
    step = (last_angle - first_angle) / (beam_count - 1)
    return Scan(ranges, first_angle, step)


@pytest.mark.parametrize("kind", SCANNERS)
@pytest.mark.parametrize(
    "layout",
    [
        pytest.param(PAPER, id="720"),
        pytest.param(Layout(90, -2.3, 2.3, 3.0), id="90"),
    ],
)
def test_resampling_equals_the_reference_implementation(kind, layout):
    scan = scan_of(kind)
    np.testing.assert_array_equal(layout.resample(*scan), plain(layout, *scan))


def test_a_scan_with_the_layouts_geometry_is_unchanged():
    ranges = scan_of("541", 1).ranges.repeat(2)[:720]
    # LaserScan has angles in single precision, which lie beside the borders of the sectors.
    first_angle = np.float32(PAPER.angle_min)
    step = np.float32(PAPER.step)
    resampled = PAPER.resample(ranges, first_angle, step)
    assert resampled.tobytes() == ranges.tobytes()
    resampled_clockwise = PAPER.resample(ranges[::-1], -first_angle, -step)
    assert resampled_clockwise.tobytes() == ranges.tobytes()


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
    ranges = np.ones(count)
    refused(
        lambda: PAPER.resample(ranges, first, step),
        line,
        kind=ObservationError,
    )


@pytest.mark.parametrize("view", [(0.5, 2.0), (-2.0, -0.5), (-0.001, 2.0)])
@pytest.mark.parametrize(
    "layout",
    [layout_of, lambda robot: DimensionlessEncoding(robot, 1.0).layout],
    ids=["paper", "dimensionless"],
)
def test_a_laser_that_does_not_look_ahead_has_no_layout(layout, view):
    """A layout is symmetric about straight ahead."""
    first_angle, last_angle = view
    laser = robots.JACKAL.laser.model_copy(
        update={"first_angle": first_angle, "last_angle": last_angle}
    )
    robot = replace(robots.JACKAL, laser=laser)
    line = f"robot jackal: its laser covers {first_angle:.3f} to {last_angle:.3f} rad, not ahead"
    refused(lambda: layout(robot), f"^{line}$")


def test_an_actor_has_its_own_layout(tmp_path):
    # An observation has 60 beams, the goal's angle and 8 parameters.
    layout = Layout(
        beams=60,
        angle_min=-1.5,
        angle_max=1.5,
        range_cap=3.0,
        lookahead=0.5,
    )
    rng = np.random.default_rng(0)
    weights = {
        "0.weight": rng.normal(size=(8, 69)).astype(np.float32),
        "0.bias": np.zeros(8, np.float32),
    }
    policy_file = tmp_path / "a.safetensors"
    save(policy_file, weights, encoding=PaperEncoding(robots.JACKAL, layout=layout))
    assert load(policy_file).layout == layout
    assert make(str(policy_file)).layout == layout
    assert make("dwa").layout == PAPER
