"""Tests of the frame of matched poses in which a planner may drive."""

import math

import numpy as np
import pytest

from applr_ros1.common.angles import compose
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.matched_frame import SUPPORT
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.monitor.scan_matching import ScanMatcher, lines, support_of
from applr_ros1.movers.tracker import Movers

STEP = (0.05, -0.02, 0.03)  # change of the matcher's correction by each scan
ONE = np.ones(1)
MOVER = Movers(ONE.astype(int), ONE, ONE, ONE, ONE, ONE, np.ones((1, 3)), ONE > 0.0)
NO_MOVER = Movers(*(values[:0] for values in MOVER))


@pytest.fixture
def add_scan(monkeypatch):
    """Return a monitor, and a function that adds a scan with moving obstacles."""
    monitor = CollisionMonitor()
    laser = monitor.lasers.first
    stamps = iter(np.arange(0.0, 9.0, 0.1))

    def match(scan, is_partial=False):
        monitor.matcher.correction = compose(monitor.matcher.correction, STEP)
        return True

    def add(movers=NO_MOVER):
        monkeypatch.setattr(laser.tracker, "update", lambda scan: movers)
        ranges = np.full(361, 3.0, np.float32)
        monitor.add_scan(LaserScan(next(stamps), -1.57, 0.0087, 0.1, 10.0, ranges, (0.0, 0.0, 0.0)))

    monkeypatch.setattr(monitor.matcher, "add_scan", match)
    monkeypatch.setattr(ScanMatcher, "support", SUPPORT)
    return monitor, add


def test_the_frame_follows_the_matcher_while_nothing_moves(add_scan):
    monitor, add = add_scan
    for _ in range(3):
        add()
    assert monitor.matched_frame.correction == pytest.approx(monitor.matcher.correction)
    assert monitor.matched_frame.correction != (0.0, 0.0, 0.0)


def test_a_scan_in_which_something_moves_does_not_correct_the_frame(add_scan):
    monitor, add = add_scan
    add()
    for _ in range(3):
        add(MOVER)
    assert monitor.matched_frame.correction == pytest.approx(STEP)
    # What was wrong meanwhile does not come back.
    add()
    assert monitor.matched_frame.correction == pytest.approx(compose(STEP, STEP))


def test_a_scan_that_leaves_a_direction_open_does_not_correct_the_frame(add_scan, monkeypatch):
    monitor, add = add_scan
    add()
    monkeypatch.setattr(ScanMatcher, "support", 0.9 * SUPPORT)
    add()
    assert monitor.matched_frame.correction == pytest.approx(STEP)


@pytest.mark.parametrize(("begin", "end", "support"), [(0, 120, 0.0), (0, 360, 0.5)])
def test_support_is_that_of_the_direction_in_which_fewest_beams_measure(begin, end, support):
    """A flat wall in a third of the beams of a turn, or a round wall in all."""
    bearings = np.radians(np.arange(360))
    ranges = np.full(360, np.nan, np.float32)
    ranges[begin:end] = 2.0
    if end == 120:
        ranges[begin:end] /= np.cos(bearings[begin:end] - np.radians(60))
    surface = lines(ranges, 0.0, math.radians(1.0))
    assert support_of(surface) == pytest.approx(support, abs=0.01)


def test_without_an_earlier_scan_there_is_no_support():
    assert ScanMatcher().support == 0.0


def test_another_drive_begins_at_the_odometrys_frame(add_scan):
    monitor, add = add_scan
    add()
    monitor.reset()
    assert monitor.matched_frame.correction == (0.0, 0.0, 0.0)
