"""Path of navfn: traces down the gradient of the potential in half-cell steps.

Called by navfn.Navfn. Follows navfn.cpp:785 and 955 (docs/explanation/planner.md, section 5.3) and
is float32 wherever C++ is. C++ reads cells outside its arrays at the ends of the map; here such
cells count as unreached.
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.navfn.flood import FAR

F32 = np.float32
ZERO = F32(0.0)
ONE = F32(1.0)
# Potential below which a point is beside the robot. The robot's cell has the potential 0, its free
# neighbours 50.
AT_ROBOT = F32(50.0)
STEEP = F32(254.0)  # gradient of an unreached cell beside a reached one (COST_OBS in C++)
STEP = 0.5  # length of a step [cells]


@kernel(error_model="numpy")
def trace(potential: Data, columns: int, rows: int, start: int, robot: int, path: Data) -> int:
    """Trace from the cell `start` down to `robot`.

    Args:
        potential: (columns rows, or more) float32 of all cells.
        columns: columns of the map.
        rows: rows of the map.
        start: flat index of the goal's cell.
        robot: flat index of the robot's cell.
        path: (4 columns, 2) float32, for the points x, y [cells].

    Returns:
        The number of points, or 0 if there is no path or it has more than 4 columns points.
    """
    # A point is a cell with an offset of up to one cell, so that steps add small numbers.
    cell_count = columns * rows
    cell = start
    offset_x = ZERO
    offset_y = ZERO
    gradient_cell = -1  # cell whose four gradients are known
    centre_x = centre_y = right_x = right_y = above_x = above_y = corner_x = corner_y = ZERO
    for point in range(path.shape[0]):
        # Finished: the nearest cell is the robot's.
        nearest_cell = cell + _round(offset_x) + columns * _round(offset_y)
        nearest_cell = min(max(nearest_cell, 0), cell_count - 1)
        if potential[nearest_cell] < AT_ROBOT:
            path[point, 0] = F32(robot % columns)
            path[point, 1] = F32(robot // columns)
            return point + 1

        if cell < columns or cell > cell_count - columns:
            return 0
        path[point, 0] = F32(cell % columns) + offset_x
        path[point, 1] = F32(cell // columns) + offset_y

        # Beside unreached cells there is no gradient, and a path that swings between two points
        # makes no progress: go on from the lowest neighbour instead.
        if _swings(path, point) or _is_beside_unreached(potential, columns, cell_count, cell):
            cell = _lowest_around(potential, columns, cell_count, cell)
            offset_x = ZERO
            offset_y = ZERO
            if potential[cell] >= FAR:
                return 0
            continue

        # Gradient at the point, between those of the cell and its neighbours right and above. A
        # half step often stays in the same cell.
        if cell != gradient_cell:
            gradient_cell = cell
            centre_x, centre_y = _gradient(potential, columns, cell_count, cell)
            right_x, right_y = _gradient(potential, columns, cell_count, cell + 1)
            above_x, above_y = _gradient(potential, columns, cell_count, cell + columns)
            corner_x, corner_y = _gradient(potential, columns, cell_count, cell + columns + 1)
        slope_x = _blend(centre_x, right_x, above_x, corner_x, offset_x, offset_y)
        slope_y = _blend(centre_y, right_y, above_y, corner_y, offset_x, offset_y)
        if slope_x == 0 and slope_y == 0:
            return 0

        # Half a cell along the gradient.
        scale = F32(STEP / np.float64(_hypot(slope_x, slope_y)))
        offset_x = offset_x + slope_x * scale
        offset_y = offset_y + slope_y * scale
        if offset_x > ONE:
            cell += 1
            offset_x = offset_x - ONE
        if offset_x < -ONE:
            cell -= 1
            offset_x = offset_x + ONE
        if offset_y > ONE:
            cell += columns
            offset_y = offset_y - ONE
        if offset_y < -ONE:
            cell -= columns
            offset_y = offset_y + ONE
    return 0


@kernel
def _swings(path: Data, number: int) -> bool:
    """Return whether a point equals the one two points before."""
    if number < 2:
        return False
    same_x: bool = path[number, 0] == path[number - 2, 0]
    same_y: bool = path[number, 1] == path[number - 2, 1]
    return same_x and same_y


@kernel
def _is_beside_unreached(potential: Data, columns: int, count: int, cell: int) -> bool:
    """Return whether a cell or one of its eight neighbours is unreached or beyond the arrays."""
    for middle_cell in (cell - columns, cell, cell + columns):
        for neighbour in (middle_cell - 1, middle_cell, middle_cell + 1):
            if neighbour < 0 or neighbour >= count or potential[neighbour] >= FAR:
                return True
    return False


@kernel
def _lowest_around(potential: Data, columns: int, count: int, cell: int) -> int:
    """Return the neighbour of lowest potential, or the cell itself if none is lower.

    C++ compares with truncated potentials.
    """
    below = cell - columns
    above = cell + columns
    lowest_potential = _truncate(potential[cell])
    lowest_cell = cell
    for neighbour in (below - 1, below, below + 1, cell - 1, cell + 1, above - 1, above, above + 1):
        if 0 <= neighbour < count and potential[neighbour] < F32(lowest_potential):
            lowest_potential = _truncate(potential[neighbour])
            lowest_cell = neighbour
    return lowest_cell


@kernel
def _gradient(potential: Data, columns: int, count: int, cell: int) -> Tuple[F32, F32]:
    """Return the normalised gradient (x, y) of a cell, float32. navfn.cpp:955."""
    if cell < columns or cell > count - columns:
        return ZERO, ZERO
    centre = potential[cell]
    left = potential[cell - 1]
    right = FAR
    if cell + 1 < count:
        right = potential[cell + 1]
    below = potential[cell - columns]
    above = FAR
    if cell + columns < count:
        above = potential[cell + columns]
    gradient_x = ZERO
    gradient_y = ZERO
    if centre >= FAR:
        # An unreached cell points to a reached neighbour, first left and below.
        if left < FAR:
            gradient_x = -STEEP
        elif right < FAR:
            gradient_x = STEEP
        if below < FAR:
            gradient_y = -STEEP
        elif above < FAR:
            gradient_y = STEEP
    else:
        if left < FAR:
            gradient_x = gradient_x + (left - centre)
        if right < FAR:
            gradient_x = gradient_x + (centre - right)
        if below < FAR:
            gradient_y = gradient_y + (below - centre)
        if above < FAR:
            gradient_y = gradient_y + (centre - above)
    length = _hypot(gradient_x, gradient_y)
    if length > 0:
        scale = F32(1.0 / np.float64(length))
        gradient_x = gradient_x * scale
        gradient_y = gradient_y * scale
    return gradient_x, gradient_y


@kernel
def _hypot(x: F32, y: F32) -> F32:
    """Return the length of a vector, as C++'s hypot of two floats rounds it."""
    wide_x = np.float64(x)
    wide_y = np.float64(y)
    return F32(math.sqrt(wide_x * wide_x + wide_y * wide_y))


@kernel
def _round(value: F32) -> int:
    """Round to the nearest integer, halves away from zero."""
    if value >= 0:
        return int(math.floor(value + 0.5))
    return -int(math.floor(-value + 0.5))


@kernel
def _truncate(value: F32) -> int:
    """Convert a float32 to a C int; a value that is too large becomes the smallest int."""
    if value >= F32(2147483648.0):
        return -2147483648
    return int(value)


@kernel
def _blend(g00: F32, g10: F32, g01: F32, g11: F32, offset_x: F32, offset_y: F32) -> F32:
    """Interpolate the gradients of four cells, with double and float32 operations mixed as in C++.

    g10 is that of the cell to the right, g01 of the one above.
    """
    share_x = 1.0 - np.float64(offset_x)
    share_y = 1.0 - np.float64(offset_y)
    lower = F32(share_x * np.float64(g00) + np.float64(offset_x * g10))
    upper = F32(share_x * np.float64(g01) + np.float64(offset_x * g11))
    return F32(share_y * np.float64(lower) + np.float64(offset_y * upper))
