"""Map of the robot's surroundings from past scans: obstacle points and observed free space.

CollisionMonitor holds one ObstacleMemory per laser and one SeenSpace. Every scanner has blind regions: a scanner with
270 degrees does not cover the rear, and obstacles occlude what lies behind them. Obstacle points are kept in the frame
of ScanMatcher's poses until they are measured again, seen through, too far away or too old. Space is unknown if neither
a scan nor the body has covered it, or if a point in it was forgotten. In unknown space the monitor limits the robot to
creep speed (safe_scale in stopping.py looks the cells up).
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.scan_matching import beam_at

CAPACITY_POINTS = 16384  # largest number of remembered points; the oldest points are dropped first
SPACING_M = 0.015  # smallest distance between stored points of neighbouring beams [m]
TOLERANCE_M = 0.08  # largest difference between a range and a point's distance if the beam has hit that point [m]
THIN_M = 0.02  # spacing of neighbouring beams beyond which an obstacle may stand between them unseen [m]
CELL_M = 0.05  # side of a cell of the grid of observed space [m]
TOUCHED_M = 0.71 * CELL_M  # distance from the body within which the centre of a touched cell may lie [m]
BEHIND_M = 0.1  # depth behind a hit that counts as observed; the robot would meet the hit first [m]
SHOWN_M = 2.5  # distance from the scanner up to which a scan observes space; exceeds all stopping distances [m]

Beams = Tuple[float, float, float, float]  # angle_min, angle_increment [rad], range_min and range_max [m] of a scan
Rays = Tuple[Array32, Beams, Pose]  # ranges (n,) [m], beams and sensor_pose of a scan


def _rays(scan: LaserScan) -> Rays:
    x, y, yaw = map(float, scan.sensor_pose)
    beams = float(scan.angle_min), float(scan.angle_increment), float(scan.range_min), float(scan.range_max)
    return np.ascontiguousarray(scan.ranges, dtype=np.float32), beams, (x, y, yaw)


class ObstacleMemory:
    """Obstacle points (x, y) [m] in a fixed frame, with the times of their measurements.

    Args:
        radius: distance from the scanner beyond which points are forgotten [m].
        seconds: age at which points are forgotten unless they are measured again [s].
    """

    def __init__(self, radius: float = 8.0, seconds: float = 300.0):
        self.radius, self.seconds = float(radius), float(seconds)
        self._points = np.zeros((CAPACITY_POINTS, 3))
        self._forgotten = np.empty((CAPACITY_POINTS, 2))
        self._count = 0

    @property
    def points(self) -> np.ndarray:
        """All remembered points (n, 2) float64 [m] in the fixed frame, oldest first."""
        return self._points[: self._count, :2]

    def clear(self) -> None:
        """Forget all points, for instance after the odometry was reset."""
        self._count = 0

    def update(self, scan: LaserScan) -> np.ndarray:
        """Add the points of a scan in the fixed frame, and remove the points that it sees through.

        Beams outside [range_min, range_max) add no point. Ranges of +inf and beyond the radius clear points in front of
        them. NaN, -inf and ranges below range_min neither add nor clear, because they measure nothing (REP 117).

        Returns:
            (k, 2) the points [m] that were forgotten because of their age, their distance or a full memory. No scan has
            shown that they are gone.
        """
        limits = self.radius, float(scan.stamp) - self.seconds, float(scan.stamp)
        self._count, lost = _update(self._points, self._count, self._forgotten, _rays(scan), limits)
        return self._forgotten[:lost]

    def around(self, pose: Pose, reach: float) -> Array:
        """Return the points (k, 2) [m] within `reach` [m] of a robot at pose (x, y, yaw), in the robot's frame."""
        near: Array = _around(self._points, self._count, tuple(map(float, pose)), float(reach))
        return near


@kernel
def _around(points: Array, count: int, pose: Pose, reach: float) -> Array:
    near = np.empty((count, 2))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    n = 0
    for k in range(count):
        dx, dy = points[k, 0] - pose[0], points[k, 1] - pose[1]
        if dx * dx + dy * dy <= reach * reach:
            near[n, 0], near[n, 1] = c * dx + s * dy, c * dy - s * dx
            n += 1
    return near[:n]


@kernel
def _update(
    points: Array, count: int, forgotten: Array, scan: Rays, limits: Tuple[float, float, float]
) -> Tuple[int, int]:
    """Update the rows (x, y, stamp) of `points`, and return the numbers of points and of rows written to `forgotten`.

    limits: largest distance of a point [m], oldest stamp of a point, and stamp of the scan [s].
    """
    ranges, beams, sensor = scan
    (angle_min, increment, range_min, range_max), (sx, sy, syaw) = beams, sensor
    radius, oldest, now = limits
    kept = lost = 0
    for k in range(count):
        x, y, stamp = points[k, 0], points[k, 1], points[k, 2]
        if _is_measured(x, y, ranges, beams, sensor):
            continue
        if stamp < oldest or (x - sx) ** 2 + (y - sy) ** 2 > radius * radius:
            forgotten[lost] = x, y
            lost += 1
            continue
        points[kept, 0], points[kept, 1], points[kept, 2] = x, y, stamp
        kept += 1
    count = kept
    surplus = min(count, max(0, count + ranges.shape[0] - points.shape[0]))
    count -= surplus  # The oldest points are at the front.
    forgotten[lost : lost + surplus] = points[:surplus, :2]
    lost += surplus
    for k in range(count):
        points[k] = points[k + surplus]
    last_x, last_y = np.inf, np.inf
    for i in range(ranges.shape[0]):
        r = ranges[i]
        if not range_min <= r < range_max:
            continue
        angle = syaw + angle_min + i * increment
        x, y = sx + r * math.cos(angle), sy + r * math.sin(angle)
        if (x - sx) ** 2 + (y - sy) ** 2 > radius * radius:
            continue
        if (x - last_x) ** 2 + (y - last_y) ** 2 < SPACING_M * SPACING_M:
            continue
        if count < points.shape[0]:
            points[count, 0], points[count, 1], points[count, 2] = x, y, now
            count += 1
        last_x, last_y = x, y
    return count, lost


@kernel
def _is_measured(x: float, y: float, ranges: Array32, beams: Beams, sensor: Pose) -> bool:
    """Return whether a scan replaces a point: a beam ends at the point, or three neighbouring beams pass it.

    False if the scanner cannot see the point, because the point is out of range or may stand between two beams.
    """
    angle_min, increment, range_min, range_max = beams
    dx, dy = x - sensor[0], y - sensor[1]
    distance = math.sqrt(dx * dx + dy * dy)
    if distance < range_min:
        return False
    n = ranges.shape[0]
    i = int(math.floor(beam_at(angle_min - 0.5 * increment, increment, math.atan2(dy, dx) - sensor[2])))
    if i >= n:
        return False
    if abs(ranges[i] - distance) < SPACING_M:
        return True
    full_turn = (n + 0.5) * abs(increment) >= 2.0 * math.pi
    if (i == 0 or i == n - 1) and not full_turn:
        return False
    met = distance < min(range_max, THIN_M / abs(increment))
    for j in range(i - 1, i + 2):
        r = ranges[j % n]
        if not r >= range_min or r < distance - TOLERANCE_M:
            return False
        met |= r < distance + TOLERANCE_M
    return met


class SeenSpace:
    """Rolling grid of observed space around the robot, in the frame of ScanMatcher's poses.

    Attributes:
        cells: (n, n) uint8, 1 if observed; the cell of point (x, y) is [floor(x / CELL_M) % n, floor(y / CELL_M) % n].
        corner: (2,) int64, floor(x / CELL_M) and floor(y / CELL_M) of the lowest cell of the window.

    Args:
        radius: distance from the robot within which obstacles are remembered [m]; the grid covers at least this circle.
    """

    def __init__(self, radius: float):
        self.cells = np.zeros((2 * math.ceil((max(radius, SHOWN_M) + 1.0) / CELL_M),) * 2, np.uint8)
        self.corner = np.zeros(2, np.int64)
        self._shown = min(SHOWN_M, float(radius))  # Space counts as observed only where obstacles are remembered.

    def clear(self) -> None:
        """Mark all cells as unknown."""
        self.cells[:] = 0

    def update(self, scan: LaserScan) -> None:
        """Mark the space that a scan in the fixed frame observes. NaN, -inf and ranges below range_min observe none."""
        shown = min(self._shown, float(scan.range_max), THIN_M / abs(float(scan.angle_increment)))
        _observe(self.cells, self.corner, _rays(scan), shown)

    def forget(self, points: Array) -> None:
        """Mark the cells around forgotten obstacle points (k, 2) [m] as unknown."""
        if len(points):
            _forget(self.cells, self.corner, points)

    def stand(self, planes: Array, reach: float, pose: Pose) -> None:
        """Mark the cells under the body (half planes within `reach` [m] of its origin) at a pose as observed."""
        x, y, yaw = pose
        _stand(self.cells, self.corner, planes, reach, (float(x), float(y), float(yaw)))


@kernel
def _follow(cells: np.ndarray, corner: np.ndarray, x: float, y: float) -> None:
    """Move the window to the robot, and mark the cells that enter it as unknown."""
    n = cells.shape[0]
    for axis, place in enumerate((x, y)):
        old, new = corner[axis], int(math.floor(place / CELL_M)) - n // 2
        low, high = min(old, new), max(old, new)
        for k in range(low, min(high, low + n)):
            if axis == 0:
                cells[k % n] = 0
            else:
                cells[:, k % n] = 0
        corner[axis] = new


@kernel
def _observe(cells: np.ndarray, corner: np.ndarray, scan: Rays, shown: float) -> None:
    ranges, (angle_min, increment, range_min, _), sensor = scan
    _follow(cells, corner, sensor[0], sensor[1])
    n = cells.shape[0]
    reach = int(shown / CELL_M)
    ci, cj = int(math.floor(sensor[0] / CELL_M)), int(math.floor(sensor[1] / CELL_M))
    for i in range(ci - reach, ci + reach + 1):
        dx = (i + 0.5) * CELL_M - sensor[0]
        row, column = cells[i % n], (cj - reach - 1) % n
        for j in range(cj - reach, cj + reach + 1):
            column = column + 1 if column + 1 < n else 0
            if row[column]:
                continue
            dy = (j + 0.5) * CELL_M - sensor[1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance > shown:
                continue
            place = beam_at(angle_min - 0.5 * increment, increment, math.atan2(dy, dx) - sensor[2])
            if place < ranges.shape[0] and ranges[int(place)] >= max(distance - BEHIND_M, range_min):
                row[column] = 1


@kernel
def _forget(cells: np.ndarray, corner: np.ndarray, points: Array) -> None:
    n, around = cells.shape[0], int(math.ceil(BEHIND_M / CELL_M))
    for k in range(points.shape[0]):
        ci, cj = int(math.floor(points[k, 0] / CELL_M)), int(math.floor(points[k, 1] / CELL_M))
        for i in range(max(ci - around, corner[0]), min(ci + around + 1, corner[0] + n)):
            for j in range(max(cj - around, corner[1]), min(cj + around + 1, corner[1] + n)):
                cells[i % n, j % n] = 0


@kernel
def _stand(cells: np.ndarray, corner: np.ndarray, planes: Array, reach: float, pose: Pose) -> None:
    _follow(cells, corner, pose[0], pose[1])
    n = cells.shape[0]
    around = int(reach / CELL_M) + 2
    ci, cj = int(math.floor(pose[0] / CELL_M)), int(math.floor(pose[1] / CELL_M))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(ci - around, ci + around + 1):
        dx = (i + 0.5) * CELL_M - pose[0]
        for j in range(cj - around, cj + around + 1):
            dy = (j + 0.5) * CELL_M - pose[1]
            x, y = c * dx + s * dy, c * dy - s * dx
            inside = True
            for k in range(planes.shape[0]):
                inside = inside and planes[k, 0] * x + planes[k, 1] * y <= planes[k, 2] + TOUCHED_M
            if inside:
                cells[i % n, j % n] = 1
