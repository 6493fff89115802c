"""Which kind of place a robot is in, for colouring parameter profiles: by how much room there is around it."""

from __future__ import annotations

import numpy as np

from worlds import World
from worlds.clearance import clearance

# label and colour, the tightest first; LIMITS [m] of the distance from the robot's middle to the nearest obstacle
REGIONS = (("tight: under 0.5 m", "#cc3311"), ("between: 0.5 to 0.9 m", "#ddaa33"), ("open: over 0.9 m", "#228833"))
LIMITS = (0.5, 0.9)
HOLD = 20  # control cycles (1 s) that a region must last, or it is part of the one before


def region_of(world: World, poses: np.ndarray) -> np.ndarray:
    """(n,) int index into REGIONS for poses (n, >= 2)."""
    raw = np.digitize(clearance(world, np.asarray(poses, dtype=np.float64)[:, :2]), LIMITS)
    regions = raw.copy()
    for i in range(1, len(raw)):
        lasts = len(raw) - i >= HOLD and np.all(raw[i : i + HOLD] == raw[i])
        regions[i] = raw[i] if raw[i] == regions[i - 1] or lasts else regions[i - 1]
    return regions
