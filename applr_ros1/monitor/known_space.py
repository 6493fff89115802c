"""Map of the robot's surroundings from past scans: obstacle points and observed free space.

CollisionMonitor holds one ObstacleMemory per laser and one SeenSpace. Every scanner has blind
regions: a scanner with 270 degrees does not cover the rear, and obstacles occlude what lies behind
them. Obstacle points are kept in the frame of ScanMatcher's poses until they are measured again,
disproved, too far away or too old. Returns from behind a point disprove it at once. A beam without
a return does not, because dark and glossy surfaces return nothing in some scans: only MISSES looks
in a row disprove a point without anything behind it. Space is unknown if neither a scan nor the
body has covered it, or if a point in it was forgotten. In unknown space the monitor limits the
robot to creep speed (safe_scale in stopping.py looks the cells up).
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.common.scan import LaserScan, covers_full_turn
from applr_ros1.monitor.rays import ScanRays, beam_at, end_point, rays_of

CAPACITY_POINTS = 16384  # largest number of remembered points; the oldest points are dropped first
SPACING_M = 0.015  # smallest distance between stored points of neighbouring beams [m]
# Largest difference between a range and a point's distance if the beam has hit that point [m].
TOLERANCE_M = 0.08
# Spacing of neighbouring beams beyond which an obstacle may stand between them unseen [m].
THIN_M = 0.02
# A look is a scan from another place than the previous look, or later: scans from one place miss a
# dark surface together. Distance [m] and time [s] from one look to the next.
LOOK_M = 0.05
LOOK_S = 3.0
# Number of looks in a row without a return that disprove a point. A surface that returns nothing in
# half of the scans is missed by that many once in a million.
MISSES = 20
CELLS_PER_M = 20.0
CELL_M = 1.0 / CELLS_PER_M  # side of a cell of the grid of observed space [m]
# Distance from the body within which the centre of a touched cell may lie [m].
TOUCHED_M = 0.71 * CELL_M
# Depth behind a hit that counts as observed [m]. The robot would meet the hit first.
BEHIND_M = 0.1
# Distance from the scanner up to which a scan observes space [m]. It exceeds all stopping
# distances.
SHOWN_M = 2.5

# What a scan shows of a point (_finding).
UNSEEN = 0
MISSED = 1
REPLACED = 2


class ObstacleMemory:
    """Obstacle points (x, y) [m] in a fixed frame, with the times of their measurements.

    Args:
        radius: distance from the scanner beyond which points are forgotten [m].
        seconds: age at which points are forgotten unless they are measured again [s].
    """

    def __init__(self, radius: float = 8.0, seconds: float = 300.0):
        self.radius = float(radius)
        self.seconds = float(seconds)
        # x, y [m], stamp of the last hit [s], and number of looks that missed the point since then.
        self._points = np.zeros((CAPACITY_POINTS, 4))
        self._forgotten = np.empty((CAPACITY_POINTS, 2))
        self.clear()

    @property
    def points(self) -> np.ndarray:
        """All remembered points (n, 2) float64 [m] in the fixed frame, oldest first."""
        return self._points[: self._count, :2]

    def clear(self) -> None:
        """Forget all points, for instance after the odometry was reset."""
        self._count = 0
        self._last_look = (-math.inf, 0.0, 0.0)  # stamp [s] and place x, y of the laser [m]

    def update(self, scan: LaserScan) -> np.ndarray:
        """Add the points of a scan in the fixed frame, and remove the points that it disproves.

        Beams outside [range_min, range_max) add no point. NaN, -inf and ranges below range_min do
        not disprove points, either, because they measure nothing (REP 117).

        Returns:
            (k, 2) the points [m] that were forgotten because of their age, their distance or a full
            memory. No scan has shown that they are gone.
        """
        stamp = float(scan.stamp)
        rays = rays_of(scan)
        look_stamp, look_x, look_y = self._last_look
        is_moved = math.hypot(rays.x - look_x, rays.y - look_y) >= LOOK_M
        is_look = is_moved or stamp - look_stamp >= LOOK_S
        if is_look:
            self._last_look = stamp, rays.x, rays.y
        self._count, forgotten_count = _update(
            self._points,
            self._count,
            self._forgotten,
            rays,
            self.radius,
            stamp - self.seconds,
            stamp,
            is_look,
        )
        return self._forgotten[:forgotten_count]

    def doubt(self, x: Array, y: Array, radius: Array) -> None:
        """Let a single scan without a return disprove the points on what moves.

        Otherwise what passes would leave a trail wherever nothing behind it returns.

        Args:
            x: (k,) centres of discs, as y [m].
            y: (k,)
            radius: (k,) radii of the discs [m].
        """
        points = self._points[: self._count]
        for disc_x, disc_y, disc_radius in zip(x, y, radius):
            distances = np.hypot(points[:, 0] - disc_x, points[:, 1] - disc_y)
            points[distances < disc_radius, 3] = MISSES

    def around(self, pose: Pose, reach: float) -> Array:
        """Return the points (k, 2) [m] near a robot, in the robot's frame.

        Points count within `reach` [m] of the robot's pose (x, y, yaw).
        """
        robot_pose = tuple(map(float, pose))
        near_points: Array = _around(self._points, self._count, robot_pose, float(reach))
        return near_points


@kernel
def _around(points: Array, count: int, pose: Pose, reach: float) -> Array:
    near_points = np.empty((count, 2))
    robot_x, robot_y, robot_yaw = pose
    cos_yaw = math.cos(robot_yaw)
    sin_yaw = math.sin(robot_yaw)
    near_count = 0
    for index in range(count):
        offset_x = points[index, 0] - robot_x
        offset_y = points[index, 1] - robot_y
        if offset_x * offset_x + offset_y * offset_y <= reach * reach:
            near_points[near_count, 0] = cos_yaw * offset_x + sin_yaw * offset_y
            near_points[near_count, 1] = cos_yaw * offset_y - sin_yaw * offset_x
            near_count += 1
    return near_points[:near_count]


@kernel
def _update(
    points: Array,
    count: int,
    forgotten: Array,
    rays: ScanRays,
    radius: float,
    oldest_stamp: float,
    stamp: float,
    is_look: bool,
) -> Tuple[int, int]:
    """Update the first `count` rows of `points` with a scan.

    Args:
        points: (CAPACITY_POINTS, 4) x, y [m], stamp [s] and misses, oldest points first.
        count: number of points.
        forgotten: (CAPACITY_POINTS, 2) gets the points that are forgotten [m].
        rays: the scan.
        radius: largest distance of a point from the laser [m].
        oldest_stamp: stamp below which a point is forgotten [s].
        stamp: stamp of the scan [s].
        is_look: whether the scan counts as a look.

    Returns:
        Number of points, and number of rows written to `forgotten`.
    """
    # Number of the oldest points, at the front, that make room for a hit of every beam.
    surplus = count + rays.ranges.shape[0] - points.shape[0]
    kept_count = 0
    forgotten_count = 0
    for index in range(count):
        x = points[index, 0]
        y = points[index, 1]
        finding = _finding(x, y, rays)
        misses = points[index, 3] + (is_look and finding == MISSED)
        if finding == REPLACED or (finding == MISSED and misses >= MISSES):
            continue
        is_far = (x - rays.x) ** 2 + (y - rays.y) ** 2 > radius * radius
        if is_far or index < surplus or points[index, 2] < oldest_stamp:
            forgotten[forgotten_count] = x, y
            forgotten_count += 1
            continue
        points[kept_count] = points[index]
        points[kept_count, 3] = misses
        kept_count += 1
    return _add_hits(points, kept_count, rays, radius, stamp), forgotten_count


@kernel
def _add_hits(points: Array, count: int, rays: ScanRays, radius: float, stamp: float) -> int:
    """Append the hits of a scan that are SPACING_M apart, and return the number of points."""
    last_x = np.inf
    last_y = np.inf
    reach = min(rays.range_max, radius)
    for beam in range(rays.ranges.shape[0]):
        if not -np.inf < rays.ranges[beam] < reach:
            continue
        x, y = end_point(rays, beam)
        apart_x = x - last_x
        apart_y = y - last_y
        if apart_x**2 + apart_y**2 < SPACING_M * SPACING_M:
            continue
        if count < points.shape[0]:
            points[count] = x, y, stamp, 0.0
            count += 1
        last_x = x
        last_y = y
    return count


@kernel
def _finding(x: float, y: float, rays: ScanRays) -> int:
    """Return what a scan shows of a point: REPLACED, MISSED or UNSEEN.

    REPLACED: a beam ends at the point, or three neighbouring beams return from behind it. MISSED:
    three neighbouring beams pass the point, but not all of them return. UNSEEN: the scanner cannot
    see the point, because the point is out of range or may stand between two beams.
    """
    offset_x = x - rays.x
    offset_y = y - rays.y
    distance = math.sqrt(offset_x * offset_x + offset_y * offset_y)
    if distance < rays.range_min:
        return UNSEEN

    # Half an increment turns the fractional index into that of the nearest beam.
    beam_count = rays.ranges.shape[0]
    bearing = math.atan2(offset_y, offset_x) - rays.yaw
    first_edge = rays.angle_min - 0.5 * rays.increment
    nearest_beam = int(math.floor(beam_at(first_edge, rays.increment, bearing)))
    if nearest_beam >= beam_count:
        return UNSEEN
    if abs(rays.ranges[nearest_beam] - distance) < SPACING_M:
        return REPLACED
    at_an_end = nearest_beam == 0 or nearest_beam == beam_count - 1
    if at_an_end and not covers_full_turn(beam_count, rays.increment):
        return UNSEEN

    # A nearer hit beside the point may hide it, and an invalid range shows nothing.
    is_met = False
    all_return = True
    for beam in range(nearest_beam - 1, nearest_beam + 2):
        measured = rays.ranges[beam % beam_count]
        if not rays.free[beam % beam_count] >= distance - TOLERANCE_M:
            return UNSEEN
        is_met |= measured < distance + TOLERANCE_M
        all_return &= measured < np.inf
    if is_met:
        return REPLACED
    # Beyond the distance at which beams are THIN_M apart, the point may stand between them.
    if distance >= min(rays.range_max, THIN_M / abs(rays.increment)):
        return UNSEEN
    return REPLACED if all_return else MISSED


class SeenSpace:
    """Rolling grid of observed space around the robot, in the frame of ScanMatcher's poses.

    Attributes:
        cells: (n, n) uint8, 1 if observed; the cell of point (x, y) is [floor(x / CELL_M) % n,
            floor(y / CELL_M) % n].
        corner: (2,) int64, floor(x / CELL_M) and floor(y / CELL_M) of the lowest cell of the
            window.

    Args:
        radius: distance from the robot within which obstacles are remembered [m]; the grid covers
            at least this circle.
    """

    def __init__(self, radius: float):
        side_cells = 2 * math.ceil((max(radius, SHOWN_M) + 1.0) / CELL_M)
        self.cells = np.zeros((side_cells, side_cells), np.uint8)
        self.corner = np.zeros(2, np.int64)
        # Space counts as observed only where obstacles are remembered.
        self._shown = min(SHOWN_M, float(radius))

    def clear(self) -> None:
        """Mark all cells as unknown."""
        self.cells[:] = 0

    def update(self, scan: LaserScan) -> None:
        """Mark the space that a scan in the fixed frame observes.

        NaN, -inf and ranges below range_min observe none.
        """
        rays = rays_of(scan)
        # Farther away than this an obstacle may stand between two beams.
        thin_distance = THIN_M / abs(rays.increment)
        shown = min(self._shown, rays.range_max, thin_distance)
        _observe(self.cells, self.corner, rays, shown)

    def forget(self, points: Array) -> None:
        """Mark the cells around forgotten obstacle points (k, 2) [m] as unknown."""
        if len(points):
            _forget(self.cells, self.corner, points)

    def stand(self, planes: Array, reach: float, pose: Pose) -> None:
        """Mark the cells under the body at a pose (x, y, yaw) as observed.

        The body is given by its half planes, which lie within `reach` [m] of its origin.
        """
        x, y, yaw = pose
        _stand(self.cells, self.corner, planes, reach, (float(x), float(y), float(yaw)))


@kernel
def cell_of(coordinate: float) -> int:
    """Return the index, along one axis, of the cell that contains a coordinate [m]."""
    return int(math.floor(coordinate * CELLS_PER_M))  # A division takes several times as long.


@kernel
def _centre_of(cell: int) -> float:
    return (cell + 0.5) * CELL_M


@kernel
def _follow(cells: np.ndarray, corner: np.ndarray, x: float, y: float) -> None:
    """Move the window of `cells` (n, n) to a place x, y [m], and mark entering cells as unknown.

    Cell i of an axis is stored in slot i modulo n, so that a cell that enters takes the slot of one
    that leaves.
    """
    side_cells = cells.shape[0]
    for axis, coordinate in enumerate((x, y)):
        old_corner = corner[axis]
        new_corner = cell_of(coordinate) - side_cells // 2
        # Up to the first n cells between both corners: those that leave if the window moves up,
        # those that enter if it moves down. Their slots are the same.
        lowest_corner = min(old_corner, new_corner)
        highest_corner = max(old_corner, new_corner)
        for cell in range(lowest_corner, min(highest_corner, lowest_corner + side_cells)):
            if axis == 0:
                cells[cell % side_cells] = 0
            else:
                cells[:, cell % side_cells] = 0
        corner[axis] = new_corner


@kernel
def _observe(cells: np.ndarray, corner: np.ndarray, rays: ScanRays, shown: float) -> None:
    """Mark the cells up to `shown` [m] from the laser that a beam observes.

    A beam observes the centre of a cell before, or just behind, the beam's end.
    """
    _follow(cells, corner, rays.x, rays.y)
    side_cells = cells.shape[0]
    reach_cells = int(shown / CELL_M)
    laser_cell_x = cell_of(rays.x)
    laser_cell_y = cell_of(rays.y)
    # Half an increment turns the fractional index of beam_at into that of the nearest beam.
    first_edge = rays.angle_min - 0.5 * rays.increment
    for cell_x in range(laser_cell_x - reach_cells, laser_cell_x + reach_cells + 1):
        offset_x = _centre_of(cell_x) - rays.x
        row = cells[cell_x % side_cells]
        # The column is counted on instead of taken modulo in each step, which is slower.
        column = (laser_cell_y - reach_cells - 1) % side_cells
        for cell_y in range(laser_cell_y - reach_cells, laser_cell_y + reach_cells + 1):
            column = column + 1 if column + 1 < side_cells else 0
            if row[column]:
                continue
            offset_y = _centre_of(cell_y) - rays.y
            distance = math.sqrt(offset_x * offset_x + offset_y * offset_y)
            if distance > shown:
                continue
            bearing = math.atan2(offset_y, offset_x) - rays.yaw
            beam = beam_at(first_edge, rays.increment, bearing)
            needed_range = max(distance - BEHIND_M, rays.range_min)
            if beam < rays.ranges.shape[0] and rays.free[int(beam)] >= needed_range:
                row[column] = 1


@kernel
def _forget(cells: np.ndarray, corner: np.ndarray, points: Array) -> None:
    """Mark the cells within BEHIND_M of points (k, 2) [m] as unknown."""
    side_cells = cells.shape[0]
    reach_cells = int(math.ceil(BEHIND_M / CELL_M))
    for index in range(points.shape[0]):
        point_cell_x = cell_of(points[index, 0])
        point_cell_y = cell_of(points[index, 1])
        # A point may have left the window, whose cells then belong to other places.
        first_x = max(point_cell_x - reach_cells, corner[0])
        end_x = min(point_cell_x + reach_cells + 1, corner[0] + side_cells)
        first_y = max(point_cell_y - reach_cells, corner[1])
        end_y = min(point_cell_y + reach_cells + 1, corner[1] + side_cells)
        for cell_x in range(first_x, end_x):
            for cell_y in range(first_y, end_y):
                cells[cell_x % side_cells, cell_y % side_cells] = 0


@kernel
def _stand(cells: np.ndarray, corner: np.ndarray, planes: Array, reach: float, pose: Pose) -> None:
    """Mark the cells whose centres are in the body (n, 3 half planes) or TOUCHED_M beside it."""
    robot_x, robot_y, robot_yaw = pose
    _follow(cells, corner, robot_x, robot_y)
    side_cells = cells.shape[0]
    # One cell for the part that int() cuts off, one because the robot is anywhere in its cell.
    reach_cells = int(reach / CELL_M) + 2
    robot_cell_x = cell_of(robot_x)
    robot_cell_y = cell_of(robot_y)
    cos_yaw = math.cos(robot_yaw)
    sin_yaw = math.sin(robot_yaw)
    for cell_x in range(robot_cell_x - reach_cells, robot_cell_x + reach_cells + 1):
        offset_x = _centre_of(cell_x) - robot_x
        for cell_y in range(robot_cell_y - reach_cells, robot_cell_y + reach_cells + 1):
            offset_y = _centre_of(cell_y) - robot_y
            forward = cos_yaw * offset_x + sin_yaw * offset_y
            leftward = cos_yaw * offset_y - sin_yaw * offset_x
            is_inside = True
            for plane in range(planes.shape[0]):
                extent = planes[plane, 0] * forward + planes[plane, 1] * leftward
                is_inside = is_inside and extent <= planes[plane, 2] + TOUCHED_M
            if is_inside:
                cells[cell_x % side_cells, cell_y % side_cells] = 1
