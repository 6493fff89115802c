"""Tests that repairs of the inflation layer equal a new spread. test_golden.py compares the costs
with C++.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters, cost_at
from tests.support.scenes import inflate
from tests.support.seeds import examples


def make(nx, ny, parameters):
    layer = InflationLayer(nx, ny, 0.05, parameters)
    layer.set_inscribed_radius(0.265)
    return layer


def blank(nx, ny):
    return np.zeros((ny, nx), np.uint8)


@given(st.integers(0, 2**32 - 1), st.sampled_from((0.1, 0.3, 0.6, 1.25)), st.floats(0.005, 0.3))
@examples(40)
def test_repairs_equal_spreading_anew(seed, radius, fill):
    """After obstacles change and windows move, the map equals that of C++, which always spreads
    anew.
    """
    rng = np.random.default_rng(seed)
    nx, ny = 50, 44
    layer = make(nx, ny, InflationParameters(radius, 3.0))
    master = blank(nx, ny)
    plain = blank(nx, ny)
    obstacles = rng.random((ny, nx)) < fill
    for _ in range(8):
        obstacles ^= rng.random((ny, nx)) < rng.choice((0.0, 0.002, 0.02))
        x0, y0 = rng.integers(0, 30, 2)
        xn = x0 + rng.integers(1, 20)
        yn = y0 + rng.integers(1, 14)
        if rng.random() < 0.3:
            x0 = 0
            y0 = 0
            xn = nx
            yn = ny
        plain[y0:yn, x0:xn] = np.where(obstacles, 254, 0)[y0:yn, x0:xn]
        base = master.copy()
        base[y0:yn, x0:xn] = plain[y0:yn, x0:xn]
        before = master.copy()
        changed = layer.update(master, base, (x0, y0, xn, yn))
        inflate(plain, (x0, y0, xn, yn), 0.05, 0.265, layer.parameters)
        np.testing.assert_array_equal(master, plain)
        assert_within(before != master, changed)


def assert_within(differs, rect):
    """Assert that the rectangle contains all differences, and that it is None if there are none."""
    ys, xs = np.nonzero(differs)
    if len(ys) == 0:
        assert rect is None
    elif rect is not None:
        assert rect[0] <= xs.min()
        assert rect[1] <= ys.min()
        assert xs.max() < rect[2]
        assert ys.max() < rect[3]
    else:
        pytest.fail("changes were not reported")


def test_costs_decay_beyond_the_inscribed_radius():
    assert [cost_at(cells, 0.05, 0.25, 10.0) for cells in (0, 5, 6)] == [254, 253, 152]
    layer = make(20, 20, InflationParameters(0.6, 3.0))
    base = blank(20, 20)
    layer.configure(InflationParameters(0.6, 10.0))
    base[10, 10] = 254
    layer.update(master := blank(20, 20), base, (0, 0, 20, 20))
    assert (layer.full_pass_due, master[10, 18]) == (True, cost_at(8, 0.05, 0.265, 10.0))


def test_short_queues_are_survived():
    """If many obstacles change at once, the queue grows or the spread starts anew."""
    rng = np.random.default_rng(3)
    layer = make(150, 150, InflationParameters(0.3, 3.0))
    plain = blank(150, 150)
    layer._queue = np.empty((4, 75), np.int32)
    layer._lost = np.empty(250, np.int64)
    master = blank(150, 150)
    for fill in (0.02, 0.1, 0.0, 0.05):
        plain[:] = np.where(rng.random(plain.shape) < fill, 254, 0)
        layer.update(master, plain.copy(), (0, 0, 150, 150))
        inflate(plain, (0, 0, 150, 150), 0.05, 0.265, layer.parameters)
        np.testing.assert_array_equal(master, plain)
