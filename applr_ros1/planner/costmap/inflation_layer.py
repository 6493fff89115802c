"""Inflation layer of a costmap: spreads decaying costs around lethal cells.

Called by costmap.Costmap. Follows costmap_2d/inflation_layer.cpp, where costs spread along
4-neighbours in order of distance (brushfire.py). A distance transform would give slightly different
costs. A full pass updates the whole map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Optional, Tuple, Type

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap import brushfire
from applr_ros1.planner.costmap.grid import (
    INSCRIBED,
    LETHAL,
    UNKNOWN,
    Bounds,
    Geometry,
    Window,
    cell_distance,
    shift,
    union,
)

LARGEST_F32 = float(np.finfo(np.float32).max)
# Bounds of a full pass [m].
EVERYWHERE = (-LARGEST_F32, -LARGEST_F32, LARGEST_F32, LARGEST_F32)
FEW = 4096  # largest number of changed obstacle cells that are repaired instead of recomputed
QUEUE_ENTRIES = 1 << 16  # entries for which the queue has room until it must grow
LOST_CELLS = 1 << 15  # cells that a repair may remove; with more the spread starts anew


@dataclass
class InflationParameters:
    """Settings of the layer, named like the ROS parameters."""

    inflation_radius: float = 0.55  # [m]
    cost_scaling_factor: float = 10.0  # [1/m]
    enabled: bool = True
    inflate_unknown: bool = False


def cost_at(distance: float, resolution: float, inscribed_radius: float, weight: float) -> int:
    """Return the cost (0 .. 254) at a distance [cells]. inflation_layer.h:109.

    Args:
        distance: distance from the obstacle [cells].
        resolution: edge length of a cell [m].
        inscribed_radius: inscribed radius of the footprint [m].
        weight: cost_scaling_factor [1/m].
    """
    if distance == 0:
        return LETHAL
    if distance * resolution <= inscribed_radius:
        return INSCRIBED
    return int(252 * math.exp(-1.0 * weight * (distance * resolution - inscribed_radius)))


@lru_cache(maxsize=8)
def _level_costs(
    distances: Tuple[float, ...], resolution: float, inscribed_radius: float, weight: float
) -> np.ndarray:
    """Return the costs (uint8) by brushfire level, from the distances [cells] by level."""
    costs = [cost_at(cells, resolution, inscribed_radius, weight) for cells in distances]
    return np.array([0] * brushfire.SEED + costs, dtype=np.uint8)


class InflationLayer:
    """Layer that inflates obstacles.

    Keeps cost tables and the spread, the costs around the obstacles of the last update.
    """

    def __init__(self, name: str, parameters: InflationParameters):
        self.name = name
        self.parameters = parameters
        self.inscribed_radius = 0.0
        self.full_pass_due = False
        # The first pass covers everything, because it is united with these bounds.
        self._last_bounds = EVERYWHERE
        self._spread_window: Optional[Window] = None

    def match_size(self, geometry: Geometry) -> None:
        """Allocate the spread and all scratch memory for a costmap of this size."""
        columns, rows, self.resolution, _, _ = geometry
        self._columns = columns
        self._rows = rows

        # Window of the obstacles in the spread, None if the spread is empty.
        self._spread_window = None
        self._cost = np.zeros((rows + 2, columns + 2), np.uint8)
        self._allocate_spread(*brushfire.types_of(0))

        # Scratch memory.
        self._touched = np.zeros(columns, np.uint8)
        self._changed = np.empty(FEW, np.int64)
        self._queue = np.empty((4, QUEUE_ENTRIES), np.int32)
        self._lost = np.empty(LOST_CELLS, np.int64)
        self._make_tables()

    def _allocate_spread(self, level_type: Type[np.integer], link_type: Type[np.integer]) -> None:
        """Allocate the levels and links of an empty spread (brushfire.Spread) of these types."""
        shape = (self._rows + 2, self._columns + 2)
        self._none = int(np.iinfo(level_type).max)
        self._level = np.full(shape, self._none, level_type)
        # The padding's walls end every step off the map.
        self._level[0, :] = self._level[-1, :] = brushfire.WALL
        self._level[:, 0] = self._level[:, -1] = brushfire.WALL
        self._link = np.zeros(self._level.size, link_type)

    def _make_tables(self) -> None:
        """Compute the tables of levels and costs for the parameters and the resolution."""
        parameters = self.parameters
        # The old spread has other levels and costs.
        self._forget()
        # No two cells of the map are further apart.
        map_reach = self._columns + self._rows
        self.reach = min(cell_distance(parameters.inflation_radius, self.resolution), map_reach)
        level_type, link_type = brushfire.types_of(self.reach)
        if self._level.dtype != level_type:
            self._allocate_spread(level_type, link_type)
        self._step_level, distances = brushfire.tables(self.reach)
        self._level_cost = _level_costs(
            distances, self.resolution, self.inscribed_radius, parameters.cost_scaling_factor
        )
        # A queue has a column for each level, too.
        if self._queue.shape[1] < len(self._level_cost):
            self._queue = np.empty((4, len(self._level_cost)), np.int32)

    def configure(self, parameters: InflationParameters) -> None:
        """Apply new parameters; if they differ, schedule a full pass, as in C++."""
        if parameters != self.parameters:
            self.parameters = parameters
            self.full_pass_due = True
            self._make_tables()

    def set_inscribed_radius(self, radius: float) -> None:
        """Set the inscribed radius [m] of a new footprint and schedule a full pass."""
        self.inscribed_radius = float(radius)
        self._make_tables()
        self.full_pass_due = True

    def update_bounds(self, bounds: Bounds, pose: Any = None, footprint: Any = None) -> Bounds:
        """Return the bounds [m] of this and the last update, plus inflation_radius."""
        min_x, min_y, max_x, max_y = union(self._last_bounds, bounds)
        self._last_bounds = bounds
        if self.full_pass_due:
            self.full_pass_due = False
            return EVERYWHERE
        radius = self.parameters.inflation_radius
        return min_x - radius, min_y - radius, max_x + radius, max_y + radius

    def reset_cells(self) -> None:
        """Cancel a scheduled full pass after the maps have been cleared."""
        self.full_pass_due = False

    def roll(self, shift_x: int, shift_y: int) -> None:
        """Shift the spread after the map has moved by (shift_x, shift_y) cells, not both 0.

        The spread is removed if it meets the border before or after the shift.
        """
        if self._spread_window is None:
            return
        left, bottom, right, top = self._spread_window
        if (
            min(left, left - shift_x) <= self.reach
            or min(bottom, bottom - shift_y) <= self.reach
            or max(right, right - shift_x) >= self._columns - self.reach
            or max(top, top - shift_y) >= self._rows - self.reach
        ):
            self._forget()
            return

        # Shift only the padded rows that the spread covers before or after the shift.
        first_row = min(bottom, bottom - shift_y) - self.reach + 1
        end_row = max(top, top - shift_y) + self.reach + 1
        links = self._link.reshape(self._level.shape)
        for values, empty_value in ((self._level, self._none), (self._cost, 0), (links, 0)):
            shift(values[first_row:end_row], shift_x, shift_y, empty_value)

        # The padding moved along, into cells on both sides.
        levels = self._level[first_row:end_row]
        moved_columns = abs(shift_x)
        levels[:, 1 : moved_columns + 1] = self._none
        levels[:, self._columns + 1 - moved_columns :] = self._none
        levels[:, 0] = levels[:, -1] = brushfire.WALL
        self._spread_window = (left - shift_x, bottom - shift_y, right - shift_x, top - shift_y)

    def _forget(self) -> None:
        """Remove the spread of all obstacles."""
        if self._spread_window is not None:
            _wipe(self._level, self._cost, self._around(self._spread_window, self._spread_reach))
            self._spread_window = None

    def _around(self, window: Window, margin: int) -> Window:
        """Return a window with `margin` [cells] more on each side, as far as the map reaches."""
        left, bottom, right, top = window
        return (
            max(0, left - margin),
            max(0, bottom - margin),
            min(self._columns, right + margin),
            min(self._rows, top + margin),
        )

    def inflate(self, master: np.ndarray, base: np.ndarray, window: Window) -> Optional[Window]:
        """Inflate a window of `base` into `master`, both (rows, columns) uint8.

        `base` holds the cells before inflation: inside the window those of the layers below,
        outside those of the master.

        Returns:
            The window around all changes in the master, or None if nothing changed.
        """
        # As in C++, a reach of 0 writes nothing, not even the inscribed cost.
        if not self.parameters.enabled or self.reach == 0:
            self._forget()
            return _apply(master, base, self._cost, self._touched, False, window)

        # Obstacles within the reach of the window spread into it, and out of it on the other side.
        seed_window = self._around(window, self.reach)
        self._spread_obstacles(base, seed_window)
        written_window = self._around(seed_window, self.reach)
        inflate_unknown = self.parameters.inflate_unknown
        return _apply(master, base, self._cost, self._touched, inflate_unknown, written_window)

    def _spread_obstacles(self, base: np.ndarray, window: Window) -> None:
        """Spread the obstacles of `base` within the window, if possible by repairing the spread."""
        last_window = self._spread_window
        self._spread_window = window
        self._spread_reach = self.reach
        spread = brushfire.Spread(
            self._level.reshape(-1),
            self._link,
            self._cost.reshape(-1),
            self._columns + 2,
            self.reach,
            self._step_level,
            self._level_cost,
        )
        seeds = self._changed
        if last_window is not None:
            around_both = union(last_window, window)
            change_count = brushfire.seed_changes(base, self._level, window, around_both, seeds)
            is_repaired = False
            if change_count >= 0:
                is_repaired = brushfire.repair(seeds, change_count, spread, self._queue, self._lost)
            if is_repaired:
                return
            _wipe(self._level, self._cost, self._around(around_both, self.reach))

        # Scratch memory grows until it suffices.
        while True:
            change_count = brushfire.seed_changes(base, self._level, window, window, seeds)
            if change_count < 0:
                seeds = np.empty(2 * len(seeds), np.int64)
            elif brushfire.rebuild(seeds, change_count, spread, self._queue):
                return
            else:
                self._queue = np.empty((4, 2 * self._queue.shape[1]), np.int32)
                _wipe(self._level, self._cost, self._around(window, self.reach))


@kernel
def _wipe(level: Data, cost: Data, window: Window) -> None:
    """Remove the spread from the cells of a window."""
    none = np.iinfo(level.dtype).max
    left, bottom, right, top = window
    for row in range(bottom + 1, top + 1):
        level[row, left + 1 : right + 1] = none
        cost[row, left + 1 : right + 1] = 0


@kernel
def _apply(
    master: Data, base: Data, cost: Data, touched: Data, inflate_unknown: bool, window: Window
) -> Optional[Window]:
    """Write the inflated cells of the window into the master; return the window of changes or None.

    touched (columns,) uint8 is scratch memory. Rows are sliced and the inner loop has no branches,
    so that it compiles to vector instructions.
    """
    left, bottom, right, top = window
    unknown = np.uint8(UNKNOWN)
    # An unknown cell takes only costs above this one.
    threshold = np.uint8(0 if inflate_unknown else 252)
    changed_columns = touched[left:right]
    changed_columns[:] = 0
    first_row = -1
    last_row = -1
    for row in range(bottom, top):
        base_row = base[row, left:right]
        cost_row = cost[row + 1, left + 1 : right + 1]
        master_row = master[row, left:right]
        row_difference = np.uint8(0)
        for index in range(master_row.shape[0]):
            # Inflation raises known cells only, and unknown cells if it is meant to.
            base_cost = base_row[index]
            spread_cost = cost_row[index]
            cost_over_unknown = spread_cost if spread_cost > threshold else unknown
            inflated_cost = (
                cost_over_unknown if base_cost == unknown else max(base_cost, spread_cost)
            )
            cell_difference = np.uint8(inflated_cost ^ master_row[index])
            row_difference |= cell_difference
            changed_columns[index] |= cell_difference
            master_row[index] = inflated_cost
        if row_difference != 0:
            if first_row < 0:
                first_row = row
            last_row = row
    if first_row < 0:
        return None

    # A row differs, so both searches end.
    first_column = 0
    while changed_columns[first_column] == 0:
        first_column += 1
    end_column = changed_columns.shape[0]
    while changed_columns[end_column - 1] == 0:
        end_column -= 1
    return left + first_column, first_row, left + end_column, last_row + 1
