"""How far points of a world are from its obstacles. Reports and training ask."""

from __future__ import annotations

import numpy as np

from applr_ros1.common.angles import outside_box

from .world import World


def clearance(world: World, points: np.ndarray, time: float = 0.0) -> np.ndarray:
    """(n,) distance [m] from each point (n, 2) to the nearest obstacle's surface; moving ones at `time` [s].

    Inside a cylinder it is negative, inside a box 0; without obstacles it is inf.
    """
    moving = [(*mover.position(time), mover.radius) for mover in world.movers]
    cylinders = np.vstack([world.cylinders, np.array(moving).reshape(-1, 3)])
    x, y = points[:, :1], points[:, 1:]
    nearest = np.min(np.hypot(x - cylinders[:, 0], y - cylinders[:, 1]) - cylinders[:, 2], axis=1, initial=np.inf)
    for bx, by, yaw, size_x, size_y in world.boxes:
        nearest = np.minimum(nearest, np.hypot(*outside_box(x[:, 0] - bx, y[:, 0] - by, yaw, size_x, size_y)))
    return nearest
