"""Tests that repairs of the inflation layer equal a new spread. test_golden.py compares the costs
with C++.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from applr_ros1.planner.costmap import brushfire, inflation_layer
from applr_ros1.planner.costmap.grid import Geometry
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters, cost_at
from tests.support.scenes import inflate
from tests.support.seeds import examples


def make(columns, rows, parameters):
    """Return a layer with the Jackal's inscribed radius."""
    layer = InflationLayer("inflation", parameters)
    layer.match_size(Geometry(columns, rows, 0.05, np.zeros(2), False))
    layer.set_inscribed_radius(0.265)
    return layer


def blank(columns, rows):
    """Return free cells (ny, nx)."""
    return np.zeros((rows, columns), np.uint8)


RADII = (0.1, 0.3, 0.6, 1.25, 1.5)  # [m]


@given(st.integers(0, 2**32 - 1), st.sampled_from(RADII), st.floats(0.005, 0.3))
@examples(40)
def test_repairs_equal_spreading_anew(seed, radius, fill):
    """After obstacles change and windows move, the map equals that of C++, which always spreads
    anew.
    """
    rng = np.random.default_rng(seed)
    nx = 50
    ny = 44
    layer = make(nx, ny, InflationParameters(radius, 3.0))
    master = blank(nx, ny)
    expected = blank(nx, ny)
    is_obstacle = rng.random((ny, nx)) < fill
    for _ in range(8):
        # Given: some obstacles have changed, and a window of the map is updated
        is_obstacle ^= rng.random((ny, nx)) < rng.choice((0.0, 0.002, 0.02))
        left, bottom = rng.integers(0, 30, 2)
        right = left + rng.integers(1, 20)
        top = bottom + rng.integers(1, 14)
        window = (left, bottom, right, top)
        if rng.random() < 0.3:
            window = (0, 0, nx, ny)
        left, bottom, right, top = window
        within = np.s_[bottom:top, left:right]
        obstacles = np.where(is_obstacle, 254, 0)[within]
        base = master.copy()
        base[within] = obstacles

        # When: the layer repairs its spread
        master_before = master.copy()
        changed = layer.inflate(master, base, window)

        # Then: the map is that of a new spread, and all changes are reported
        expected[within] = obstacles
        inflate(expected, window, 0.05, 0.265, layer.parameters)
        np.testing.assert_array_equal(master, expected)
        assert_within(master_before != master, changed)


@given(st.integers(0, 2**32 - 1), st.sampled_from((0.1, 0.3, 0.6)))
@examples(40)
def test_repairs_of_a_map_that_moves_equal_spreading_anew(seed, radius):
    rng = np.random.default_rng(seed)
    layer = make(80, 74, InflationParameters(radius, 3.0))
    master = blank(80, 74)
    for _ in range(8):
        # Given: the map has moved over free space, and a window in its middle has other obstacles
        shift_x, shift_y = rng.integers(-4, 5, 2)
        if shift_x != 0 or shift_y != 0:
            layer.roll(shift_x, shift_y)
        master = ndimage.shift(master, (-shift_y, -shift_x), order=0)
        left, bottom = rng.integers(24, 34, 2)
        right = left + rng.integers(1, 20)
        top = bottom + rng.integers(1, 14)
        base = master.copy()
        is_obstacle = rng.random((top - bottom, right - left)) < 0.02
        base[bottom:top, left:right] = np.where(is_obstacle, 254, 0)

        # When: the layer repairs its spread
        expected = base.copy()
        layer.inflate(master, base, (left, bottom, right, top))

        # Then: the map is that of a new spread
        inflate(expected, (left, bottom, right, top), 0.05, 0.265, layer.parameters)
        np.testing.assert_array_equal(master, expected)


def spread_as_in_cpp(master, radius):
    """Inflate all cells in place in the order of inflation_layer.cpp: a queue for each distance."""
    rows, columns = master.shape
    obstacles = [tuple(cell) for cell in np.argwhere(master == 254)]
    queues = {0.0: [(cell, cell) for cell in obstacles]}
    seen = set()
    while queues:
        distance = min(queues)
        # Entries of the same distance may be appended on the way.
        for (row, column), (source_row, source_column) in queues[distance]:
            if (row, column) in seen:
                continue
            seen.add((row, column))
            cost = cost_at(distance, 0.05, 0.265, 3.0)
            master[row, column] = max(master[row, column], cost)
            neighbours = (row, column - 1), (row - 1, column), (row, column + 1), (row + 1, column)
            for next_row, next_column in neighbours:
                if not (0 <= next_row < rows and 0 <= next_column < columns):
                    continue
                next_distance = math.hypot(next_row - source_row, next_column - source_column)
                if distance < next_distance <= radius:
                    entry = (next_row, next_column), (source_row, source_column)
                    queues.setdefault(next_distance, []).append(entry)
        del queues[distance]


# 25 cells is the largest radius whose levels are narrow, 200 cells is larger than the map.
@pytest.mark.parametrize("radius", [6, 25, 26, 40, 200])
def test_a_spread_of_any_width_is_that_of_cpp(radius):
    rng = np.random.default_rng(radius)
    layer = make(60, 50, InflationParameters(0.05 * radius - 0.01, 3.0))
    master = blank(60, 50)
    master[rng.random(master.shape) < 0.005] = 254
    expected = master.copy()
    spread_as_in_cpp(expected, radius)
    layer.inflate(master, master.copy(), (0, 0, 60, 50))
    np.testing.assert_array_equal(master, expected)


def spread_on(columns, rows, reach):
    """Return an empty brushfire.Spread over a map, with costs that name the levels."""
    step_level, distances = brushfire.tables(reach)
    level_type, link_type = brushfire.types_of(reach)
    level = np.full((rows + 2, columns + 2), np.iinfo(level_type).max, level_type)
    level[[0, -1]] = brushfire.WALL
    level[:, [0, -1]] = brushfire.WALL
    level = level.reshape(-1)
    link = np.zeros(len(level), link_type)
    cost = np.zeros(len(level), np.uint8)
    level_cost = 254 - np.arange(len(distances) + brushfire.SEED, dtype=np.uint8)
    return brushfire.Spread(level, link, cost, columns + 2, reach, step_level, level_cost)


@pytest.mark.parametrize("lost_count", [*range(0, 400, 16), 1 << 14])
@pytest.mark.parametrize("queued_count", [60, 100, 200, 400, 1 << 14])
def test_scratch_memory_that_is_too_short_is_refused_and_not_exceeded(lost_count, queued_count):
    """Kernels do not check indices, so that a write beyond the end would spoil other arrays."""
    # Given: the spread of two obstacles, of which one leaves and another one comes
    reach = 5
    columns = 40
    (first, second, third) = (10 * 42 + 10, 10 * 42 + 14, 12 * 42 + 12)
    long_queue = np.empty((4, 1 << 14), np.int32)
    spread = spread_on(columns, 40, reach)
    assert brushfire.rebuild(np.array([first, second]), 2, spread, long_queue)
    expected = spread_on(columns, 40, reach)
    assert brushfire.rebuild(np.array([second, third]), 2, expected, long_queue)

    # When: it is repaired with memory of a certain length
    lost = np.full(lost_count + 1000, -7, np.int64)
    queue = np.full((4, queued_count), -7, np.int32)
    changes = np.array([first, third])
    is_repaired = brushfire.repair(changes, 2, spread, queue, lost[:lost_count])

    # Then: nothing behind the end is written, and a repaired spread is the new one
    assert np.all(lost[lost_count:] == -7)
    if is_repaired:
        np.testing.assert_array_equal(spread.cost, expected.cost)
    is_long = lost_count > 4 * (2 * reach + 1) ** 2
    if lost_count == 0:
        assert not is_repaired
    if is_long and queued_count > 1000:
        assert is_repaired


def assert_within(differs, window):
    """Assert that the window contains all differences, and that it is None if there are none."""
    rows, columns = np.nonzero(differs)
    if len(rows) == 0:
        assert window is None
        return
    assert window is not None, "changes were not reported"
    left, bottom, right, top = window
    assert left <= columns.min()
    assert bottom <= rows.min()
    assert columns.max() < right
    assert rows.max() < top


# The inscribed radius of 0.25 m is 5 cells.
@pytest.mark.parametrize(
    ("cells", "cost"),
    [
        (0, 254),
        (5, 253),
        (6, 152),
    ],
)
def test_costs_decay_beyond_the_inscribed_radius(cells, cost):
    assert cost_at(cells, 0.05, 0.25, 10.0) == cost


def test_short_queues_are_survived(monkeypatch):
    """If many obstacles change at once, the queue grows or the spread starts anew."""
    rng = np.random.default_rng(3)
    # Both are too short for what comes, in this layer alone.
    with monkeypatch.context() as short:
        short.setattr(inflation_layer, "QUEUE_ENTRIES", 75)
        short.setattr(inflation_layer, "LOST_CELLS", 250)
        layer = make(150, 150, InflationParameters(0.3, 3.0))
    expected = blank(150, 150)
    master = blank(150, 150)
    for fill in (0.02, 0.1, 0.0, 0.05):
        is_obstacle = rng.random(expected.shape) < fill
        expected[:] = np.where(is_obstacle, 254, 0)
        layer.inflate(master, expected.copy(), (0, 0, 150, 150))
        inflate(expected, (0, 0, 150, 150), 0.05, 0.265, layer.parameters)
        np.testing.assert_array_equal(master, expected)
