"""Segmentation of a scan into clusters of neighbouring points, and a disc fitted to each cluster.

MoverTracker calls find_clusters for each scan. tracks.py calls `centre` once the radius of a disc
is known.
"""

import math
from typing import Any, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.movers.free_space import Fan, full_turn

MAX_CLUSTERS = 256  # maximum number of clusters per scan
REACH_M = 8.0  # range beyond which a cluster is left out [m]
LARGEST_M = 0.8  # radius beyond which a cluster is left out [m]
WIDEST_RAD = 1.3  # half angle of a cluster beyond which it is left out [rad]
POINTS = 3  # number of points of a cluster that are kept as evidence of its motion

# x, y: centre [m]. radius [m]. near: nearest range [m]. start, end: bearings of the edges in the
# fixed frame, beside the first and the last beam [rad]. start_hidden, end_hidden: whether a nearer
# or unknown point occludes that edge. sigma: standard deviation of the centre [m]. points: places
# [m] in the cluster, POINTS of them.
CLUSTER = np.dtype(
    [
        ("x", np.float64),
        ("y", np.float64),
        ("radius", np.float64),
        ("near", np.float64),
        ("start", np.float64),
        ("end", np.float64),
        ("sigma", np.float64),
        ("points", np.float64, (POINTS, 2)),
        ("start_hidden", np.bool_),
        ("end_hidden", np.bool_),
    ],
    align=True,
)
Cluster = Any  # a record of CLUSTER, which numba knows by its dtype
Clusters = Any  # an array (n,) of them

# Minimum angle of incidence at which a surface stays one cluster [rad] (Borges and Aldon, "Line
# Extraction in 2D Range Images for Mobile Robotics", J. Int. Rob. Sys. 2004).
GRAZING_RAD = 0.2
FINEST_RAD = 0.02  # smallest value of this angle less an increment [rad]
# Gap between neighbouring points that never splits a cluster, to allow for noise [m]
APART_M = 0.08
GAP_BEAMS = 3  # maximum number of beams from one point of a cluster to the next
FEWEST_POINTS = 3  # minimum number of points per cluster
# Standard deviation of a centre [m]: a constant part, a part of the spacing of the beams, and
# further parts if an edge is occluded, the last in proportion to the hidden width.
SIGMA_M = 0.02
SIGMA_SPACING = 0.3
SIGMA_HIDDEN_M = 0.05
SIGMA_HIDDEN_WIDTH = 0.5


class Scan(NamedTuple):
    """Scan as the kernels take it.

    ranges: (n,) float32 [m]. points: (n, 2) ends of the beams in the laser's frame [m]. is_hit:
    (n,) whether something is there. fan: FAN of the scan. split_factor: spacing, per beam and
    range, of neighbouring points of a surface at GRAZING_RAD.
    """

    ranges: Array32
    points: Array
    is_hit: np.ndarray
    fan: Fan
    split_factor: float


@kernel
def find_clusters(ranges: Array32, directions: Array, fans: Any, clusters: Clusters) -> int:
    """Find the clusters of a scan, and return their number.

    Args:
        ranges: (n,) float32 [m].
        directions: (n, 2) cosine and sine of each beam.
        fans: (1,) FAN of the scan.
        clusters: (MAX_CLUSTERS,) CLUSTERs, of which the first ones are filled.
    """
    beam_count = ranges.shape[0]
    step = abs(fans[0].increment)
    # Law of sines in the triangle of the laser and two neighbouring points
    split_factor = math.sin(step) / math.sin(max(GRAZING_RAD - step, FINEST_RAD))
    points = np.empty((beam_count, 2))
    is_hit = np.empty(beam_count, np.bool_)
    scan = Scan(ranges, points, is_hit, fans[0], split_factor)
    _fill_points(scan, directions)
    is_full_turn = full_turn(beam_count, step)
    # In a full turn a cluster may wrap around from the last beam to the first: start at a gap.
    start_beam = 0
    if is_full_turn:
        while start_beam < beam_count - 1 and _is_joined(scan, start_beam - 1, start_beam):
            start_beam += 1
    end_beam = start_beam + beam_count

    count = 0
    beam = start_beam
    while beam < end_beam and count < MAX_CLUSTERS:
        if not _is_hit(scan, beam):
            beam += 1
            continue

        # Follow the surface from point to point, across missing beams.
        first_beam = beam
        last_beam = beam
        point_count = 1
        near = ranges[_index(beam, beam_count)]
        beam = first_beam + 1
        while beam <= last_beam + GAP_BEAMS and beam < end_beam:
            if _is_joined(scan, last_beam, beam):
                last_beam = beam
                point_count += 1
                near = min(near, ranges[_index(beam, beam_count)])
            beam += 1
        beam = last_beam + 1

        if point_count >= FEWEST_POINTS and near < REACH_M:
            cluster = clusters[count]
            cluster.near = near
            cluster.start_hidden = _hides(scan, first_beam, -1, is_full_turn)
            cluster.end_hidden = _hides(scan, last_beam, 1, is_full_turn)
            if _measure(scan, first_beam, last_beam, cluster):
                count += 1
    return count


@kernel
def _index(beam: int, beam_count: int) -> int:
    """Return the index of a beam, which may lie up to one turn before the first or past the last.

    It is the remainder of a division, which would take most of the time for a scan.
    """
    if beam >= beam_count:
        return beam - beam_count
    if beam < 0:
        return beam + beam_count
    return beam


@kernel
def _fill_points(scan: Scan, directions: Array) -> None:
    """Fill `points` and `is_hit` from the directions (n, 2) of the beams."""
    for beam in range(scan.ranges.shape[0]):
        distance = scan.ranges[beam]
        scan.points[beam, 0] = distance * directions[beam, 0]
        scan.points[beam, 1] = distance * directions[beam, 1]
        scan.is_hit[beam] = np.isfinite(distance)


@kernel
def _is_hit(scan: Scan, beam: int) -> bool:
    return bool(scan.is_hit[_index(beam, scan.ranges.shape[0])])


@kernel
def _point(scan: Scan, beam: int) -> Tuple[float, float]:
    """Return the end point x, y [m] of a beam in the laser's frame."""
    index = _index(beam, scan.ranges.shape[0])
    return scan.points[index, 0], scan.points[index, 1]


@kernel
def _is_joined(scan: Scan, first_beam: int, second_beam: int) -> bool:
    """Return whether the points of two beams belong to one surface."""
    if not (_is_hit(scan, first_beam) and _is_hit(scan, second_beam)):
        return False
    beam_count = scan.ranges.shape[0]
    first_range = scan.ranges[_index(first_beam, beam_count)]
    second_range = scan.ranges[_index(second_beam, beam_count)]
    first_x, first_y = _point(scan, first_beam)
    second_x, second_y = _point(scan, second_beam)
    offset_x = first_x - second_x
    offset_y = first_y - second_y
    beams_apart = second_beam - first_beam
    apart = APART_M + beams_apart * scan.split_factor * min(first_range, second_range)
    return bool(offset_x * offset_x + offset_y * offset_y < apart * apart)


@kernel
def _hides(scan: Scan, edge_beam: int, direction: int, is_full_turn: bool) -> bool:
    """Return whether the beam next to a cluster's edge may occlude more of the cluster."""
    ranges = scan.ranges
    beam_count = ranges.shape[0]
    next_beam = edge_beam + direction
    if not is_full_turn and not 0 <= next_beam < beam_count:
        return True
    # What is unknown or too near occludes, too.
    next_range = ranges[_index(next_beam, beam_count)]
    return not next_range >= ranges[_index(edge_beam, beam_count)]


@kernel
def _measure(scan: Scan, first_beam: int, last_beam: int, cluster: Cluster) -> bool:
    """Fit a disc to the beams `first_beam` to `last_beam`. Return False if it is too large."""
    fan = scan.fan
    step = abs(fan.increment)
    first_x, first_y = _point(scan, first_beam)
    last_x, last_y = _point(scan, last_beam)
    beams_apart = last_beam - first_beam
    half_angle = 0.5 * (beams_apart + 1) * step
    chord = math.hypot(last_x - first_x, last_y - first_y) + step * cluster.near
    if half_angle > WIDEST_RAD or chord > 2.0 * LARGEST_M:
        return False

    # The chord between the tangents to a disc is 2 radius cos(half_angle).
    cluster.radius = min(0.5 * chord / math.cos(half_angle), chord)
    cluster.sigma = SIGMA_M + SIGMA_SPACING * step * cluster.near
    cluster.start = fan.yaw + fan.angle_min + fan.increment * (first_beam - 0.5)
    cluster.end = fan.yaw + fan.angle_min + fan.increment * (last_beam + 0.5)
    x, y, _ = centre(cluster, cluster.radius, fan)
    cluster.x = x
    cluster.y = y

    # Points in the middle of each third.
    cos_yaw = math.cos(fan.yaw)
    sin_yaw = math.sin(fan.yaw)
    for index in range(POINTS):
        beam = first_beam + ((2 * index + 1) * beams_apart) // (2 * POINTS)
        while not _is_hit(scan, beam):
            beam += 1
        point_x, point_y = _point(scan, beam)
        cluster.points[index, 0] = fan.x + cos_yaw * point_x - sin_yaw * point_y
        cluster.points[index, 1] = fan.y + sin_yaw * point_x + cos_yaw * point_y
    return True


@kernel
def centre(cluster: Cluster, radius: float, fan: Fan) -> Tuple[float, float, float]:
    """Return the centre (x, y) and its standard deviation [m] of a disc from its visible part.

    If the next beam beyond an edge reaches farther, the edge is a true one. If the other edge is
    occluded, the centre is placed one radius inward from the visible edge.

    Args:
        cluster: CLUSTER of the disc.
        radius: known radius of the disc [m].
        fan: FAN of the scan.
    """
    distance = cluster.near + radius
    half_angle = math.asin(min(radius / distance, 1.0))
    bearing = 0.5 * (cluster.start + cluster.end)
    sigma = cluster.sigma
    if cluster.start_hidden or cluster.end_hidden:
        seen_half = 0.5 * abs(cluster.end - cluster.start)
        hidden_width = max(half_angle - seen_half, 0.0)
        sigma += SIGMA_HIDDEN_M + SIGMA_HIDDEN_WIDTH * hidden_width * distance
        if half_angle > seen_half and cluster.start_hidden != cluster.end_hidden:
            inward = math.copysign(half_angle, cluster.end - cluster.start)
            if cluster.end_hidden:
                bearing = cluster.start + inward
            else:
                bearing = cluster.end - inward
    x = fan.x + distance * math.cos(bearing)
    y = fan.y + distance * math.sin(bearing)
    return x, y, sigma
