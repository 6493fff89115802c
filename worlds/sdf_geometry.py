"""Poses and shapes of SDF.

Transforms are composed in three dimensions, then each collision is cut down to what a ground robot meets, a circle or a
rectangle. Only `sdf_reader` uses it.
"""

from __future__ import annotations

import itertools
import math
from typing import Optional, Sequence, Tuple

import numpy as np

ROBOT_BAND = (0.02, 0.50)  # heights [m] between which an obstacle is in a Jackal's way
UPRIGHT = 0.996  # a cylinder whose axis tilts less (5 degrees) counts as upright

Circle = Tuple[float, float, float]
Rectangle = Tuple[float, float, float, float, float]


def transform(pose: Sequence[float]) -> np.ndarray:
    """(4, 4) from SDF's x y z roll pitch yaw (fixed axes: R = Rz Ry Rx)."""
    x, y, z, roll, pitch, yaw = pose
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y],
            [-sp, cp * sr, cp * cr, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def in_the_way(low: float, high: float) -> bool:
    """Whether something between these heights [m] stands in a Jackal's way."""
    return high > ROBOT_BAND[0] and low < ROBOT_BAND[1]


def cylinder(pose: np.ndarray, radius: float, length: float) -> Tuple[Optional[Circle], Optional[Rectangle]]:
    """What a Jackal meets of a cylinder: (circle, rectangle), one of them None.

    The circle of an upright one, the rectangle around a lying or leaning one, (None, None) for one that a Jackal passes
    under or over.
    """
    axis = pose[:3, 2]
    flat = math.hypot(axis[0], axis[1])
    reach = 0.5 * length * abs(axis[2]) + radius * flat
    if not in_the_way(pose[2, 3] - reach, pose[2, 3] + reach):
        return None, None
    x, y = float(pose[0, 3]), float(pose[1, 3])
    if abs(axis[2]) >= UPRIGHT:
        return (x, y, float(radius)), None
    along = length * flat + 2.0 * radius * abs(axis[2])
    return None, (x, y, math.atan2(axis[1], axis[0]), float(along), 2.0 * float(radius))


def sphere(pose: np.ndarray, radius: float) -> Optional[Circle]:
    """The sphere's widest circle, or None where a Jackal passes under or over it."""
    if not in_the_way(pose[2, 3] - radius, pose[2, 3] + radius):
        return None
    return float(pose[0, 3]), float(pose[1, 3]), float(radius)


def box(pose: np.ndarray, size: Sequence[float]) -> Optional[Rectangle]:
    """The rectangle that a box covers, exact if it stands on a face; None where a Jackal passes under or over."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    corners = (signs * np.asarray(size)) @ pose[:3, :3].T
    if not in_the_way(pose[2, 3] + corners[:, 2].min(), pose[2, 3] + corners[:, 2].max()):
        return None
    # the axis that lies flattest gives the rectangle's direction; the first one in a tie
    axes = np.hypot(pose[0, :3], pose[1, :3])
    main = int(np.argmax(axes > axes.max() - 1e-9))
    yaw = math.atan2(pose[1, main], pose[0, main])
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = corners[:, 0] * c + corners[:, 1] * s, corners[:, 1] * c - corners[:, 0] * s
    return (float(pose[0, 3]), float(pose[1, 3]), yaw, float(np.ptp(along)), float(np.ptp(across)))
