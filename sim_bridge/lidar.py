"""Exact planar laser scanner among circles and boxes, called by Simulator.scan.

Only the beams within the angle that an obstacle covers are intersected with the obstacle. A scan of
720 beams among several hundred cylinders therefore takes some microseconds. Rays of a physics
engine are slow and wrong by up to a centimetre. Tests compare the scans with brute force.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array, Array32, Ints
from applr_ros1.common.kernels import kernel
from applr_ros1.robots.robot import Laser

from .records import Records, record

_NO_MOVERS = np.empty((0, 3))
# Margins of the angle that an obstacle covers, above the errors of _bearing and of the arcsine
# [rad]
_CIRCLE_MARGIN = 0.0005
_EDGE_MARGIN = 0.001
# Sum of the coefficients of arcsin's series after the second one: pi / 2 - 7 / 6, rounded up
_ARCSINE_REST = 0.4041297


@dataclass
class BeamFan:
    """Geometry of the beams of one laser."""

    first_angle: float  # [rad]
    increment: float  # angle between two beams [rad]
    beams_per_turn: float
    range_min: float  # [m]
    range_max: float  # [m]


class LaserBeams(NamedTuple):
    """Beams of one laser."""

    fan: BeamFan
    cosines: Array  # (beams,) cosine and sine of each beam's angle
    sines: Array


class Lidar:
    """Laser scanner in one static world.

    Args:
        laser: Description of the laser.
        cylinders: (n, 3) x, y, radius [m].
        boxes: (m, 5) x, y, yaw, size_x, size_y [m, rad].
    """

    def __init__(self, laser: Laser, cylinders: Array, boxes: Array) -> None:
        self._fan = _fan(laser)
        angles = laser.first_angle + laser.increment * np.arange(laser.beams)
        self._cosines = np.cos(angles)
        self._sines = np.sin(angles)
        self.circles = np.ascontiguousarray(cylinders, dtype=np.float64).reshape(-1, 3)
        self.edges = box_edges(np.asarray(boxes, dtype=np.float64).reshape(-1, 5))
        self._order = np.arange(len(self.circles))  # circles by distance in the last scan
        self._squares = np.empty(len(self.circles))  # squared distances in the last scan [m^2]

    def scan(self, x: float, y: float, yaw: float, movers: Array = _NO_MOVERS) -> Array32:
        """Return the exact ranges (beams,) float32 [m] of the laser at (x, y) with heading `yaw`.

        +inf means nothing within range_max, and -inf an obstacle nearer than range_min or around
        the laser. `movers` (k, 3) are additional circles x, y, radius for this scan only.
        """
        ranges = np.empty(len(self._cosines), dtype=np.float32)
        _scan(
            (x, y, yaw),
            self.circles,
            movers,
            self.edges,
            self._order,
            self._squares,
            self._fan,
            self._cosines,
            self._sines,
            ranges,
        )
        return ranges


def _fan(laser: Laser) -> Records:
    """Return the record (1,) of a laser's BeamFan."""
    first_angle = laser.first_angle
    while first_angle > pi:  # Bearings from -pi to pi must lie at most one turn away from the fan.
        first_angle -= 2 * pi
    fan = BeamFan(
        first_angle=first_angle,
        increment=laser.increment,
        beams_per_turn=round(2 * pi / laser.increment),
        range_min=laser.range_min,
        range_max=laser.range_max,
    )
    return record(fan)


def box_edges(boxes: Array) -> Array:
    """Return the sides (4 m, 4) x0, y0, x1, y1 of boxes (m, 5), counter-clockwise [m]."""
    unit_corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    edges = [np.empty((0, 4))]
    for x, y, yaw, size_x, size_y in boxes:
        cos_yaw = np.cos(yaw)
        sin_yaw = np.sin(yaw)
        rotation = np.array([(cos_yaw, sin_yaw), (-sin_yaw, cos_yaw)])
        corners = unit_corners * (size_x / 2, size_y / 2) @ rotation + (x, y)
        next_corners = np.roll(corners, -1, axis=0)
        edges.append(np.hstack([corners, next_corners]))
    return np.concatenate(edges)


@kernel
def _bearing(y: float, x: float) -> float:
    """Approximate atan2(y, x) with an error below .0003 rad.

    The result only selects the beams to test. It needs no more accuracy, because the margins of the
    covered angle are larger, and at least one more beam is tested on either side.
    """
    abs_x = abs(x)
    abs_y = abs(y)
    larger = max(abs_x, abs_y)
    if larger == 0.0:
        return 0.0
    ratio = min(abs_x, abs_y) / larger
    ratio2 = ratio * ratio
    # Polynomial for atan(ratio) on [0, 1], in Horner's form
    outer = ratio2 * (0.1801410 + ratio2 * (-0.0851330 + ratio2 * 0.0208351))
    angle = ratio * (0.9998660 + ratio2 * (-0.3302995 + outer))
    if abs_y > abs_x:
        angle = 1.5707963267948966 - angle
    if x < 0.0:
        angle = 3.141592653589793 - angle
    return -angle if y < 0.0 else angle


@kernel
def _cut_circle(
    circle: Array,
    laser_x: float,
    laser_y: float,
    cos_yaw: float,
    sin_yaw: float,
    rays: LaserBeams,
    nearest: Array,
) -> bool:
    """Shorten the ranges of beams that hit a circle.

    Args:
        circle: x, y, radius of the circle [m].
        laser_x: Place of the laser [m].
        laser_y: Place of the laser [m].
        cos_yaw: Cosine of the laser's heading.
        sin_yaw: Sine of the laser's heading.
        rays: Beams of the laser.
        nearest: Ranges so far (beams,) [m].

    Returns:
        True if the laser is inside the circle.
    """
    fan = rays.fan
    offset_x = circle[0] - laser_x
    offset_y = circle[1] - laser_y
    radius = circle[2]
    square = offset_x * offset_x + offset_y * offset_y
    if square <= radius * radius:
        return True
    distance = sqrt(square)
    gap = distance - radius
    if gap > fan.range_max:
        return False

    # Centre in the laser frame
    x = cos_yaw * offset_x + sin_yaw * offset_y
    y = cos_yaw * offset_y - sin_yaw * offset_x

    # Beams within the angle that the circle covers, from an upper bound of arcsin(radius /
    # distance): its series is ratio (1 + ratio^2 / 6 + ...), where all further terms together are
    # at most _ARCSINE_REST ratio^4.
    ratio = radius / distance
    series = 1.0 + ratio * ratio * (0.1666667 + ratio * ratio * _ARCSINE_REST)
    half_angle = ratio * series + _CIRCLE_MARGIN
    middle = _bearing(y, x)
    beams = nearest.shape[0]
    lowest = int((middle - half_angle - fan.first_angle) / fan.increment)
    highest = int((middle + half_angle - fan.first_angle) / fan.increment) + 1
    beams_per_turn = int(fan.beams_per_turn)
    squared_tangent = square - radius * radius  # length from the laser to the circle, squared [m^2]
    for turn in range(-1, 2):  # An obstacle behind the laser may reach into either end of the fan.
        first = lowest + turn * beams_per_turn
        last = highest + turn * beams_per_turn + 1
        if last < 0 or first >= beams:
            continue
        for beam in range(max(first - 1, 0), min(last + 1, beams - 1) + 1):
            # A beam that has already hit something nearer than the circle stays as it is.
            if gap < nearest[beam]:
                # Distance to the foot of the perpendicular from the centre
                along = x * rays.cosines[beam] + y * rays.sines[beam]
                squared_half_chord = along * along - squared_tangent  # negative for a miss
                if squared_half_chord >= 0.0 and along > 0.0:
                    reach = along - sqrt(squared_half_chord)
                    if reach < nearest[beam]:
                        nearest[beam] = reach
    return False


@kernel
def _cut_edge(x0: float, y0: float, x1: float, y1: float, rays: LaserBeams, nearest: Array) -> None:
    """Shorten the ranges `nearest` (beams,) of beams that hit a side of a box.

    The side leads from (x0, y0) to (x1, y1) in the laser frame [m].
    """
    fan = rays.fan
    bearing = _bearing(y0, x0)
    span = _bearing(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)  # signed angle from first end to second
    beams = nearest.shape[0]
    low_angle = min(bearing, bearing + span) - _EDGE_MARGIN
    high_angle = max(bearing, bearing + span) + _EDGE_MARGIN
    lowest = int((low_angle - fan.first_angle) / fan.increment)
    highest = int((high_angle - fan.first_angle) / fan.increment) + 1
    beams_per_turn = int(fan.beams_per_turn)
    edge_x = x1 - x0
    edge_y = y1 - y0
    cross = x0 * edge_y - y0 * edge_x
    for turn in range(-1, 2):
        first = lowest + turn * beams_per_turn
        last = highest + turn * beams_per_turn
        for beam in range(max(first - 1, 0), min(last + 2, beams - 1) + 1):
            cosine = rays.cosines[beam]
            sine = rays.sines[beam]
            # Intersection of two lines by Cramer's rule; 0 for a beam parallel to the side
            across = cosine * edge_y - sine * edge_x
            if across != 0.0:
                reach = cross / across
                # Place of the hit along the side: 0 at the first end, 1 at the second
                share = (x0 * sine - y0 * cosine) / across
                if 0.0 < reach < nearest[beam] and -1e-12 <= share <= 1.0 + 1e-12:
                    nearest[beam] = reach


@kernel
def _sort(order: Ints, keys: Array) -> None:
    """Sort `order` (n,), a permutation, by `keys` (n,), with insertion sort.

    This is fast, because the order of the last scan is nearly right. In a new world, 400 circles
    take less than 0.1 ms.
    """
    for rank in range(1, order.shape[0]):
        moved = order[rank]
        place = rank - 1
        while place >= 0 and keys[order[place]] > keys[moved]:
            order[place + 1] = order[place]
            place -= 1
        order[place + 1] = moved


@kernel
def _scan(
    pose: Pose,
    circles: Array,
    movers: Array,
    edges: Array,
    order: Ints,
    squares: Array,
    fans: Records,
    cosines: Array,
    sines: Array,
    ranges: Array32,
) -> None:
    """Write the ranges (beams,) of a laser at `pose` [m, m, rad]; see Lidar.

    `order` (n,) are the indices of `circles` by distance, which are sorted again. `squares` (n,) is
    room for the squared distances [m^2]. `fans` is the record (1,) of a BeamFan, `cosines` and
    `sines` (beams,) are those of the beams' angles.
    """
    x, y, yaw = pose
    fan: BeamFan = fans[0]
    rays = LaserBeams(fan, cosines, sines)
    nearest = np.full(ranges.shape[0], fan.range_max)
    cos_yaw = np.cos(yaw)
    sin_yaw = np.sin(yaw)
    covered = False

    # From near to far, because a circle behind nearer ones is skipped without a square root.
    for index in range(circles.shape[0]):
        offset_x = circles[index, 0] - x
        offset_y = circles[index, 1] - y
        squares[index] = offset_x * offset_x + offset_y * offset_y
    _sort(order, squares)
    for index in order:
        covered |= _cut_circle(circles[index], x, y, cos_yaw, sin_yaw, rays, nearest)
    for index in range(movers.shape[0]):
        covered |= _cut_circle(movers[index], x, y, cos_yaw, sin_yaw, rays, nearest)

    # Boxes, four sides each
    for index in range(0, edges.shape[0], 4):
        inside = True
        for row in range(index, index + 4):
            x0 = edges[row, 0] - x
            y0 = edges[row, 1] - y
            x1 = edges[row, 2] - x
            y1 = edges[row, 3] - y
            if x0 * y1 - y0 * x1 > 0.0:  # The laser is on the inner side of this edge.
                continue
            inside = False  # Only sides that face the laser are visible.
            _cut_edge(
                cos_yaw * x0 + sin_yaw * y0,
                cos_yaw * y0 - sin_yaw * x0,
                cos_yaw * x1 + sin_yaw * y1,
                cos_yaw * y1 - sin_yaw * x1,
                rays,
                nearest,
            )
        covered |= inside

    # Codes of REP 117
    for beam in range(ranges.shape[0]):
        if covered or nearest[beam] <= fan.range_min:
            ranges[beam] = -np.inf
        elif nearest[beam] >= fan.range_max:
            ranges[beam] = np.inf
        else:
            ranges[beam] = nearest[beam]
