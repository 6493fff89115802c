"""How the layers of a costmap write into the grid that becomes the master: costmap_2d/costmap_layer.cpp.

Called by costmap.Costmap and the layers. Grids are (ny, nx) uint8; a window is (x0, y0, xn, yn) in cells.
"""

from __future__ import annotations

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import UNKNOWN

OVERWRITE = 0  # values of combination_method
MAXIMUM = 1


@kernel
def begin(master, base, default, layer, merging, x0, y0, xn, yn, ax0, ay0, axn, ayn):
    """`base` becomes the default value inside the window, and as the master is in the rest of the rectangle around.

    With `merging` the known cells of the lowest layer are written into the window at once; on default values it makes
    no difference how they are combined.
    """
    empty = np.uint8(default)
    unknown = np.uint8(UNKNOWN)
    for y in range(ay0, ayn):
        if not y0 <= y < yn:
            _copy(master[y, ax0:axn], base[y, ax0:axn])
            continue
        _copy(master[y, ax0:x0], base[y, ax0:x0])
        _copy(master[y, xn:axn], base[y, xn:axn])
        target = base[y, x0:xn]
        if merging:
            values = layer[y, x0:xn]
            for i in range(values.shape[0]):
                target[i] = values[i] if values[i] != unknown else empty
        else:
            for i in range(target.shape[0]):
                target[i] = empty


@kernel
def merge(layer, base, maximum, x0, y0, xn, yn):
    """Known cells of the layer replace those of `base` in the window; with `maximum` only lower or unknown ones."""
    unknown = np.uint8(UNKNOWN)
    for y in range(y0, yn):
        values = layer[y, x0:xn]
        target = base[y, x0:xn]
        if maximum:
            for i in range(values.shape[0]):
                value = values[i]
                old = target[i]
                # 255 of the layer leaves the old value; 255 of the base counts as lower than anything
                target[i] = value if value != unknown and (old == unknown or old < value) else old
        else:
            for i in range(values.shape[0]):
                target[i] = values[i] if values[i] != unknown else target[i]


@kernel
def replace(layer, base, x0, y0, xn, yn):
    """All cells of the layer, unknown ones too, replace those of `base` in the window."""
    for y in range(y0, yn):
        _copy(layer[y, x0:xn], base[y, x0:xn])


@kernel
def _copy(source, target):
    for i in range(source.shape[0]):
        target[i] = source[i]
