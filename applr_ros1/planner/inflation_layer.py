"""Inflation layer of a costmap: spreads falling costs around lethal cells.

Called by costmap.Costmap. Follows costmap_2d/inflation_layer.cpp: sources pass along 4-neighbours in order of
distance, first in first out, so a distance transform would give other bytes.
"""
import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from applr_ros1.planner.grid import LETHAL, UNKNOWN, cell_distance

LARGEST_F32 = float(np.finfo(np.float32).max)


@dataclass
class InflationParameters:
    """Settings of the layer, named as the ROS parameters."""
    inflation_radius: float = 0.55       # [m]
    cost_scaling_factor: float = 10.0    # [1/m]
    enabled: bool = True
    inflate_unknown: bool = False


class InflationLayer:
    """Keeps the tables of distances and costs and what is due; cells belong to the costmap."""

    def __init__(self, nx, ny, resolution, parameters):
        self.resolution = float(resolution)
        self.parameters = parameters
        self.inscribed_radius = 0.0
        self.full_pass_due = False
        self._last = np.array([-LARGEST_F32, -LARGEST_F32, LARGEST_F32, LARGEST_F32])
        self._seen = np.zeros((ny, nx), np.uint8)
        self._entries = np.empty((4 * nx * ny + 4, 4), np.int32)
        self._tables()

    def _tables(self):
        p = self.parameters
        self.reach = cell_distance(p.inflation_radius, self.resolution)
        n = self.reach + 2
        axis = np.arange(n, dtype=np.float64)
        distance = np.hypot(axis[:, None], axis[None, :])
        values = np.unique(distance[distance <= self.reach])
        self._bin = np.where(distance <= self.reach, np.searchsorted(values, distance), -1).astype(np.int32)
        self._bins = len(values)
        self._cost = np.array([[cost_at(d, self.resolution, self.inscribed_radius, p.cost_scaling_factor)
                                for d in row] for row in distance.tolist()], dtype=np.uint8)

    def configure(self, parameters):
        """Take new parameters; a full pass becomes due where the C++ layer asks for one."""
        old = self.parameters
        self.parameters = parameters
        if (parameters.inflation_radius != old.inflation_radius
                or parameters.cost_scaling_factor != old.cost_scaling_factor):
            self._tables()
            self.full_pass_due = True
        if parameters.enabled != old.enabled or parameters.inflate_unknown != old.inflate_unknown:
            self.full_pass_due = True

    def set_inscribed_radius(self, radius):
        """The footprint was set: its inscribed radius [m]. A full pass becomes due."""
        self.inscribed_radius = float(radius)
        self._tables()
        self.full_pass_due = True

    def update_bounds(self, bounds):
        """Widen `bounds` (4,) [m] in place. inflation_layer.cpp:129."""
        incoming = bounds.copy()
        if self.full_pass_due:
            self.full_pass_due = False
            bounds[:2] = -LARGEST_F32
            bounds[2:] = LARGEST_F32
        else:
            radius = self.parameters.inflation_radius
            bounds[:2] = np.minimum(self._last[:2], incoming[:2]) - radius
            bounds[2:] = np.maximum(self._last[2:], incoming[2:]) + radius
        self._last = incoming

    def update_costs(self, master, x0, y0, xn, yn):
        """Inflate the window [x0, xn) x [y0, yn) of `master` (ny, nx) in place."""
        if self.reach == 0:
            return
        ny, nx = master.shape
        r = self.reach
        _inflate(master, self._seen, self._entries, self._bin, self._cost, self._bins, self.parameters.inflate_unknown,
                 max(0, x0 - r), max(0, y0 - r), min(nx, xn + r), min(ny, yn + r))

    def reset(self):
        """After the maps were cleared: no full pass is due."""
        self.full_pass_due = False


def cost_at(distance, resolution, inscribed_radius, weight):
    """Cost (0 .. 254) at a distance in cells. inflation_layer.h:109."""
    if distance == 0:
        return LETHAL
    if distance * resolution <= inscribed_radius:
        return 253
    return int(252 * math.exp(-1.0 * weight * (distance * resolution - inscribed_radius)))


@njit(cache=True)
def _inflate(master, seen, entries, bin_of, cost_of, bins, inflate_unknown, x0, y0, xn, yn):
    """entries (m, 4): x, y, source (as x + nx y), next entry of the same bin."""
    ny, nx = master.shape
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
                new = cost_of[abs(y - sy), abs(x - sx)]
                old = master[y, x]
                if old == UNKNOWN:
                    if new >= 253 or (inflate_unknown and new > 0):
                        master[y, x] = new
                elif new > old:
                    master[y, x] = new
                for k in range(4):
                    px = x
                    py = y
                    if k == 0:
                        px = x - 1
                    elif k == 1:
                        py = y - 1
                    elif k == 2:
                        px = x + 1
                    else:
                        py = y + 1
                    if px < 0 or py < 0 or px >= nx or py >= ny or seen[py, px] != 0:
                        continue
                    nb = bin_of[abs(py - sy), abs(px - sx)]
                    if nb < 0:
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
