"""Which space around the robot scans have shown, or the body has been in. CollisionMonitor holds one SeenSpace.

A scanner of 270 degrees shows nothing behind the robot before it has driven or turned, and none sees behind what it
sees. In what stays unknown the monitor lets the robot creep only (safe_scale in stopping.py looks the cells up).
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.monitor.scan_matching import beam_at

CELL = 0.05  # [m]
TOUCHED = 0.71 * CELL  # [m]: a cell whose middle is so far from the body may be touched by it
BEHIND = 0.1  # [m]: so far behind a point where a beam has ended nothing can be reached but through the point
APART = 0.1  # [m]: where beams are farther apart, what stands between them is not shown
SHOWN = 2.5  # [m] from the scanner within which a scan shows space: farther than any stopping distance


class SeenSpace:
    """A grid that moves with the robot in the frame of ScanMatcher's poses: 1 where a cell is known.

    Attributes:
        cells: (n, n) uint8; the cell of point (x, y) is [floor(x / CELL) % n, floor(y / CELL) % n].
        corner: (2,) int64, floor(x / CELL) and floor(y / CELL) of the lowest cell of the window.

    Args:
        radius: distance [m] from the robot within which cells are kept, and obstacles remembered.
    """

    def __init__(self, radius):
        self.cells = np.zeros((2 * math.ceil((max(radius, SHOWN) + 1.0) / CELL),) * 2, np.uint8)
        self.corner = np.zeros(2, np.int64)
        self._shown = min(SHOWN, float(radius))  # what would not be remembered is not shown either

    def clear(self):
        """Nothing has been seen."""
        self.cells[:] = 0

    def update(self, scan):
        """Takes a scan (planner.costmap.scan.LaserScan in the fixed frame); NaN, -inf, under range_min show nothing."""
        ranges = np.ascontiguousarray(scan.ranges, dtype=np.float32)
        beams = float(scan.angle_min), float(scan.angle_increment), float(scan.range_min)
        x, y, yaw = map(float, scan.sensor_pose)
        shown = min(self._shown, float(scan.range_max), APART / abs(beams[1]))
        _see(self.cells, self.corner, ranges, beams, (x, y, yaw), shown)

    def forget(self, points):
        """Points (k, 2) [m] of obstacles that the memory has let go: what is about them counts as not seen."""
        if len(points):
            _forget(self.cells, self.corner, points)

    def stand(self, planes, reach, pose):
        """The body (half planes within `reach` [m] of its origin) is at pose (x, y, yaw): what it touches is free."""
        x, y, yaw = pose
        _stand(self.cells, self.corner, planes, reach, (float(x), float(y), float(yaw)))


@kernel
def _follow(cells, corner, x, y):
    """Move the window to the robot; what comes in on the other side has not been seen."""
    n = cells.shape[0]
    for axis, place in enumerate((x, y)):
        old, new = corner[axis], int(math.floor(place / CELL)) - n // 2
        low, high = min(old, new), max(old, new)
        for k in range(low, min(high, low + n)):
            if axis == 0:
                cells[k % n] = 0
            else:
                cells[:, k % n] = 0
        corner[axis] = new


@kernel
def _see(cells, corner, ranges, beams, sensor, shown):
    _follow(cells, corner, sensor[0], sensor[1])
    angle_min, increment, range_min = beams
    n = cells.shape[0]
    reach = int(shown / CELL)
    ci, cj = int(math.floor(sensor[0] / CELL)), int(math.floor(sensor[1] / CELL))
    for i in range(ci - reach, ci + reach + 1):
        dx = (i + 0.5) * CELL - sensor[0]
        row, column = cells[i % n], (cj - reach - 1) % n
        for j in range(cj - reach, cj + reach + 1):
            column = column + 1 if column + 1 < n else 0
            if row[column]:
                continue
            dy = (j + 0.5) * CELL - sensor[1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance > shown:
                continue
            place = beam_at(angle_min - 0.5 * increment, increment, math.atan2(dy, dx) - sensor[2])
            if place < ranges.shape[0] and ranges[int(place)] >= max(distance - BEHIND, range_min):
                row[column] = 1


@kernel
def _forget(cells, corner, points):
    n, around = cells.shape[0], int(math.ceil(BEHIND / CELL))
    for k in range(points.shape[0]):
        ci, cj = int(math.floor(points[k, 0] / CELL)), int(math.floor(points[k, 1] / CELL))
        for i in range(max(ci - around, corner[0]), min(ci + around + 1, corner[0] + n)):
            for j in range(max(cj - around, corner[1]), min(cj + around + 1, corner[1] + n)):
                cells[i % n, j % n] = 0


@kernel
def _stand(cells, corner, planes, reach, pose):
    _follow(cells, corner, pose[0], pose[1])
    n = cells.shape[0]
    around = int(reach / CELL) + 2
    ci, cj = int(math.floor(pose[0] / CELL)), int(math.floor(pose[1] / CELL))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(ci - around, ci + around + 1):
        dx = (i + 0.5) * CELL - pose[0]
        for j in range(cj - around, cj + around + 1):
            dy = (j + 0.5) * CELL - pose[1]
            x, y = c * dx + s * dy, c * dy - s * dx
            inside = True
            for k in range(planes.shape[0]):
                inside = inside and planes[k, 0] * x + planes[k, 1] * y <= planes[k, 2] + TOUCHED
            if inside:
                cells[i % n, j % n] = 1
