"""Inflation layer of a costmap: spreads decaying costs around lethal cells.

Called by costmap.Costmap. Follows costmap_2d/inflation_layer.cpp, where costs spread along 4-neighbours in order of
distance (brushfire.py). A distance transform would give slightly different costs. A full pass updates the whole map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Optional, Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap import brushfire
from applr_ros1.planner.costmap.grid import INSCRIBED, LETHAL, UNKNOWN, Bounds, Window, cell_distance, union

LARGEST_F32 = float(np.finfo(np.float32).max)
EVERYWHERE = (-LARGEST_F32, -LARGEST_F32, LARGEST_F32, LARGEST_F32)  # bounds of a full pass [m]
FEW = 4096  # largest number of changed obstacle cells for which costs are repaired instead of recomputed


@dataclass
class InflationParameters:
    """Settings of the layer, named like the ROS parameters."""

    inflation_radius: float = 0.55  # [m]
    cost_scaling_factor: float = 10.0  # [1/m]
    enabled: bool = True
    inflate_unknown: bool = False


def cost_at(distance: float, resolution: float, inscribed_radius: float, weight: float) -> int:
    """Return the cost (0 .. 254) at a distance [cells]; `weight` is cost_scaling_factor. inflation_layer.h:109."""
    if distance == 0:
        return LETHAL
    if distance * resolution <= inscribed_radius:
        return INSCRIBED
    return int(252 * math.exp(-1.0 * weight * (distance * resolution - inscribed_radius)))


@lru_cache(maxsize=8)
def _level_costs(distances: Tuple[float, ...], resolution: float, inscribed_radius: float, weight: float) -> np.ndarray:
    """Return the costs (uint8) by brushfire level, from the distances [cells] of the levels from SEED on."""
    costs = [cost_at(d, resolution, inscribed_radius, weight) for d in distances]
    return np.array([0] * brushfire.SEED + costs, dtype=np.uint8)


class InflationLayer:
    """Layer that inflates obstacles. Keeps cost tables and the spread: the costs around the last update's obstacles."""

    def __init__(
        self, nx: int, ny: int, resolution: float, parameters: InflationParameters, name: str = "inflater_layer"
    ):
        self.name = name
        self.parameters = parameters
        self.inscribed_radius = 0.0
        self.full_pass_due = False
        self._last = EVERYWHERE
        self._allocate(nx, ny, resolution)

    def match_size(self, nx: int, ny: int, resolution: float, origin: Any) -> None:
        """Adapt to the size of the costmap."""
        self._allocate(nx, ny, resolution)

    def _allocate(self, nx: int, ny: int, resolution: float) -> None:
        self.resolution = float(resolution)
        self._nx, self._ny = nx, ny
        self._level = np.full((ny + 2, nx + 2), brushfire.NONE, np.uint8)
        self._level[0, :] = self._level[-1, :] = self._level[:, 0] = self._level[:, -1] = brushfire.WALL
        self._link = np.zeros((ny + 2) * (nx + 2), np.uint16)
        self._cost = np.zeros((ny + 2, nx + 2), np.uint8)
        self._columns = np.zeros(nx, np.uint8)
        self._changed = np.empty(FEW, np.int64)
        self._queue = np.empty((4, 1 << 16), np.int32)
        self._lost = np.empty(1 << 15, np.int64)
        self._seen: Any = None
        self._entries: Any = None  # queue, used if the reach exceeds MAX_REACH
        self._spread: Any = None  # rectangle of the obstacles in the spread; None if the spread is empty
        self._make_tables()

    def _make_tables(self) -> None:
        p = self.parameters
        self._forget()
        self.reach = cell_distance(p.inflation_radius, self.resolution)
        self._incremental = self.reach <= brushfire.MAX_REACH
        if self._incremental:
            self._step_level, distances = brushfire.tables(self.reach)
        else:
            axis = np.arange(self.reach + 2, dtype=np.float64)
            distance = np.hypot(axis[:, None], axis[None, :])
            distances = tuple(np.unique(distance[distance <= self.reach]).tolist())
            self._bin = np.where(distance <= self.reach, np.searchsorted(distances, distance), -1).astype(np.int32)
        self._level_cost = _level_costs(distances, self.resolution, self.inscribed_radius, p.cost_scaling_factor)

    def configure(self, parameters: InflationParameters) -> None:
        """Apply new parameters; if they differ, schedule a full pass, as in C++."""
        if parameters != self.parameters:
            self.parameters, self.full_pass_due = parameters, True
            self._make_tables()

    def set_inscribed_radius(self, radius: float) -> None:
        """Set the inscribed radius [m] of a new footprint and schedule a full pass."""
        self.inscribed_radius = float(radius)
        self._make_tables()
        self.full_pass_due = True

    def update_bounds(self, bounds: Bounds, pose: Any = None, footprint: Any = None) -> Bounds:
        """Return the bounds (min x, min y, max x, max y) [m] of this and the last update, plus inflation_radius."""
        last, self._last = self._last, bounds
        if self.full_pass_due:
            self.full_pass_due = False
            return EVERYWHERE
        x0, y0, xn, yn = union(last, bounds)
        radius = self.parameters.inflation_radius
        return x0 - radius, y0 - radius, xn + radius, yn + radius

    def reset(self) -> None:
        """Cancel a scheduled full pass after the maps have been cleared."""
        self.full_pass_due = False

    def roll(self, cx: int, cy: int) -> None:
        """Shift the spread after the map has moved by (cx, cy) cells; remove the spread if it meets the border."""
        if self._spread is None:
            return
        r = self.reach
        x0, y0, xn, yn = self._spread
        if (
            min(x0 - r, x0 - r - cx) <= 0
            or min(y0 - r, y0 - r - cy) <= 0
            or max(xn + r, xn + r - cx) >= self._nx
            or max(yn + r, yn + r - cy) >= self._ny
        ):
            self._forget()
            return
        width = self._nx + 2
        first = min(y0, y0 - cy) - r + 1
        last = max(yn, yn - cy) + r + 1
        k = cy * width + cx
        for grid, empty in ((self._level, brushfire.NONE), (self._cost, 0), (self._link.reshape(-1, width), 0)):
            rows = grid[first:last].reshape(-1)
            if k > 0:
                rows[:-k] = rows[k:]
                rows[-k:] = empty
            else:
                rows[-k:] = rows[:k].copy()
                rows[:-k] = empty
        walls = self._level[first:last]
        n = abs(cx)
        walls[:, 1 : n + 1] = brushfire.NONE
        walls[:, width - 1 - n :] = brushfire.NONE
        walls[:, 0] = walls[:, -1] = brushfire.WALL
        self._spread = (x0 - cx, y0 - cy, xn - cx, yn - cy)

    def _forget(self) -> None:
        """Remove the spread of all obstacles."""
        if self._spread is not None:
            _wipe(self._level, self._cost, *self._around(self._spread, self._spread_reach))
            self._spread = None

    def _around(self, rect: Window, cells: int) -> Window:
        x0, y0, xn, yn = rect
        return max(0, x0 - cells), max(0, y0 - cells), min(self._nx, xn + cells), min(self._ny, yn + cells)

    def update(self, master: np.ndarray, base: np.ndarray, window: Window) -> Optional[Window]:
        """Inflate the window (x0, y0, xn, yn) of `base` into `master`, both (ny, nx) uint8.

        `base` holds the cells before inflation: inside the window those of the layers below, outside those of the
        master. Returns the rectangle around all changes in the master, or None if nothing changed.
        """
        if not self.parameters.enabled or self.reach == 0:
            self._forget()
            return _apply(master, base, self._cost, self._columns, False, window)
        if not self._incremental:
            return self._update_anew(master, base, window)
        seeds_in = self._around(window, self.reach)
        self._spread_obstacles(base, seeds_in)
        around = self._around(seeds_in, self.reach)
        return _apply(master, base, self._cost, self._columns, self.parameters.inflate_unknown, around)

    def _spread_obstacles(self, base: np.ndarray, rect: Window) -> None:
        """Spread the obstacles of `base` within the rectangle, by repairing the last spread if possible."""
        before, self._spread = self._spread, rect
        self._spread_reach = self.reach
        spread = self._level, self._link, self._cost.reshape(-1), self._step_level, self._level_cost, self.reach
        if before is not None:
            both = union(before, rect)
            count = brushfire.seed_changes(base, self._level, rect, both, self._changed)
            if count >= 0 and brushfire.repair(self._changed, count, spread, self._queue, self._lost):
                return
            _wipe(self._level, self._cost, *self._around(both, self.reach))
        seeds = self._changed
        while True:
            count = brushfire.seed_changes(base, self._level, rect, rect, seeds)
            if count >= 0 and brushfire.rebuild(seeds, count, spread, self._queue):
                return
            if count < 0:
                seeds = np.empty(2 * len(seeds), np.int64)
            else:
                self._queue = np.empty((4, 2 * self._queue.shape[1]), np.int32)
                _wipe(self._level, self._cost, *self._around(rect, self.reach))

    def _update_anew(self, master: np.ndarray, base: np.ndarray, window: Window) -> Optional[Window]:
        """Update with a reach beyond MAX_REACH by spreading everything anew, as C++ always does."""
        rect = self._around(window, 2 * self.reach)
        x0, y0, xn, yn = rect
        before = master[y0:yn, x0:xn].copy()
        master[y0:yn, x0:xn] = base[y0:yn, x0:xn]
        if self._entries is None:
            self._seen = np.zeros(master.shape, np.uint8)
            self._entries = np.empty((5 * master.size, 4), np.int32)
        tables = self._bin, self._level_cost
        seeds_in = self._around(window, self.reach)
        _inflate(master, self._seen, self._entries, *tables, self.parameters.inflate_unknown, seeds_in)
        return None if np.array_equal(before, master[y0:yn, x0:xn]) else rect


@kernel
def _wipe(level: Data, cost: Data, x0: int, y0: int, xn: int, yn: int) -> None:
    """Remove the spread from the cells [x0, xn) x [y0, yn)."""
    for y in range(y0 + 1, yn + 1):
        level[y, x0 + 1 : xn + 1] = brushfire.NONE
        cost[y, x0 + 1 : xn + 1] = 0


@kernel
def _apply(
    master: Data, base: Data, cost: Data, columns: Data, inflate_unknown: bool, window: Window
) -> Optional[Window]:
    """Write the inflated cells of the window into the master; return the rectangle of changes or None.

    columns (nx,) is scratch memory. Rows are sliced so that the inner loop compiles to vector instructions.
    """
    x0, y0, xn, yn = window
    lowest = np.uint8(0 if inflate_unknown else 252)  # An unknown cell takes only costs above this.
    unknown = np.uint8(UNKNOWN)
    touched = columns[x0:xn]
    touched[:] = 0
    first = -1
    last = -1
    for y in range(y0, yn):
        olds = base[y, x0:xn]
        news = cost[y + 1, x0 + 1 : xn + 1]
        row = master[y, x0:xn]
        differs = np.uint8(0)
        for i in range(row.shape[0]):
            old = olds[i]
            new = news[i]
            spread = new if new > lowest else unknown
            grown = spread if old == unknown else max(old, new)
            difference = np.uint8(grown ^ row[i])
            differs |= difference
            touched[i] |= difference
            row[i] = grown
        if differs != 0:
            if first < 0:
                first = y
            last = y
    if first < 0:
        return None
    left = 0
    while touched[left] == 0:
        left += 1
    right = touched.shape[0]
    while touched[right - 1] == 0:
        right -= 1
    return x0 + left, first, x0 + right, last + 1


@kernel
def _inflate(
    master: Data, seen: Data, entries: Data, bin_of: Data, level_cost: Data, inflate_unknown: bool, window: Window
) -> None:
    """Spread costs as C++ does, with one queue per distance.

    Rows of entries (m, 4): x, y, source (as x + nx y), next entry of the same level.
    """
    (ny, nx), (x0, y0, xn, yn) = master.shape, window
    bins = level_cost.shape[0] - 1
    head = np.full(bins, -1, np.int64)
    tail = np.full(bins, -1, np.int64)
    used = 0
    for y in range(y0, yn):
        for x in range(x0, xn):
            if master[y, x] == LETHAL:
                entries[used, 0] = x
                entries[used, 1] = y
                entries[used, 2] = y * nx + x
                entries[used, 3] = -1
                if head[0] < 0:
                    head[0] = used
                else:
                    entries[tail[0], 3] = used
                tail[0] = used
                used += 1
    for b in range(bins):
        e = head[b]
        while e >= 0:
            x = entries[e, 0]
            y = entries[e, 1]
            source = entries[e, 2]
            if seen[y, x] == 0:
                seen[y, x] = 1
                sx = source % nx
                sy = source // nx
                new = level_cost[b + 1]
                old = master[y, x]
                if old == UNKNOWN:
                    if new >= 253 or (inflate_unknown and new > 0):
                        master[y, x] = new
                elif new > old:
                    master[y, x] = new
                for k in range(4):
                    px = x - (k == 0) + (k == 2)
                    py = y - (k == 1) + (k == 3)
                    if px < 0 or py < 0 or px >= nx or py >= ny or seen[py, px] != 0:
                        continue
                    nb = bin_of[abs(py - sy), abs(px - sx)]
                    if nb <= b:
                        continue
                    entries[used, 0] = px
                    entries[used, 1] = py
                    entries[used, 2] = source
                    entries[used, 3] = -1
                    if head[nb] < 0:
                        head[nb] = used
                    else:
                        entries[tail[nb], 3] = used
                    tail[nb] = used
                    used += 1
            e = entries[e, 3]
    for i in range(used):
        seen[entries[i, 1], entries[i, 0]] = 0
