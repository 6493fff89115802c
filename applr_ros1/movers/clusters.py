"""Segmentation of a scan into clusters of neighbouring points, and a disc fitted to each cluster.

MoverTracker calls find_clusters for each scan. tracks.py calls `centre` once the radius of a disc is known.
"""

import math
from typing import Tuple

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.kernels import kernel
from applr_ros1.movers.free_space import full_turn

# Ranges (n,) float32 of a scan [m], cosine and sine of its beams (n, 2), (first angle, increment [rad], range_min,
# range_max [m]), and pose of the laser in the fixed frame.
Scan = Tuple[Array32, Array, Tuple[float, float, float, float], Pose]

MAX_CLUSTERS = 256  # maximum number of clusters per scan
REACH_M = 8.0  # range beyond which a cluster is left out [m]
LARGEST_M = 0.8  # radius beyond which a cluster is left out [m]
# Columns of a cluster: raw centre [m], radius [m], nearest range [m], bearings of its edges in the fixed frame [rad]
# (first, last beam), per edge (first, last beam) whether a nearer or unknown point occludes it, standard deviation of
# the centre [m], and three of its points [m].
CX, CY, RADIUS, NEAR, FROM, TO, HIDDEN_FROM, HIDDEN_TO, SIGMA, POINTS = range(10)
COLUMNS = POINTS + 6

# Minimum angle of incidence at which a surface stays one cluster [rad] (Borges and Aldon, J. Int. Rob. Sys. 2004).
GRAZING_RAD = 0.2
APART_M = (
    0.08  # gap between neighbouring points that never splits a cluster, to allow for noise [m]
)
GAP_BEAMS = 3  # maximum number of beams from one point of a cluster to the next
FEWEST_POINTS = 3  # minimum number of points per cluster


@kernel
def find_clusters(scan: Scan, clusters: Array) -> int:
    """Fill `clusters` (MAX_CLUSTERS, COLUMNS) from a scan, and return the number of clusters."""
    ranges, _, limits, _ = scan
    n = ranges.shape[0]
    step = abs(limits[1])
    widen = math.sin(step) / math.sin(max(GRAZING_RAD - step, 0.02))
    full = full_turn(n, step)
    begin = 0  # In a full turn a cluster may wrap around from the last beam to the first: start at a gap.
    while full and begin < n - 1 and _joined(scan, begin - 1, begin, widen):
        begin += 1
    count, k = 0, begin
    while k < begin + n and count < MAX_CLUSTERS:
        if not _hit(ranges[k % n], limits):
            k += 1
            continue
        first = last = k
        points, near = 1, ranges[k % n]
        while True:
            k = last + 1
            while k < min(last + GAP_BEAMS, begin + n) and not _joined(scan, last, k, widen):
                k += 1
            if k >= begin + n or not _joined(scan, last, k, widen):
                break
            last = k
            points += 1
            near = min(near, ranges[k % n])
        k = last + 1
        if points >= FEWEST_POINTS and near < REACH_M:
            cluster = clusters[count]
            cluster[NEAR] = near
            cluster[HIDDEN_FROM] = _hides(scan, first, -1, full)
            cluster[HIDDEN_TO] = _hides(scan, last, 1, full)
            if _measure(scan, first, last, cluster):
                count += 1
    return count


@kernel
def _hit(r: float, limits: Tuple[float, float, float, float]) -> bool:
    return limits[2] <= r < limits[3]


@kernel
def _joined(scan: Scan, a: int, b: int, widen: float) -> bool:
    """Return whether the points of beams a and b belong to one surface."""
    ranges, table, limits, _ = scan
    n = ranges.shape[0]
    i, j = a % n, b % n
    r, q = ranges[i], ranges[j]
    if not (_hit(r, limits) and _hit(q, limits)):
        return False
    dx, dy = r * table[i, 0] - q * table[j, 0], r * table[i, 1] - q * table[j, 1]
    apart = APART_M + (b - a) * widen * min(r, q)
    return bool(dx * dx + dy * dy < apart * apart)


@kernel
def _hides(scan: Scan, edge: int, way: int, full: bool) -> float:
    """Return 1.0 if the beam next to a cluster's edge may occlude more of the cluster, else 0.0."""
    ranges = scan[0]
    n = ranges.shape[0]
    beyond = edge + way
    if not full and not 0 <= beyond < n:
        return 1.0
    r = ranges[beyond % n]
    return 0.0 if r >= ranges[edge % n] else 1.0  # NaN and ranges below range_min occlude, too.


@kernel
def _measure(scan: Scan, first: int, last: int, cluster: Array) -> bool:
    """Fit a disc to the beams `first` to `last`. Return False if it is larger than LARGEST_M."""
    ranges, table, limits, sensor = scan
    n = ranges.shape[0]
    step = abs(limits[1])
    i, j = first % n, last % n
    ax, ay = ranges[i] * table[i, 0], ranges[i] * table[i, 1]
    bx, by = ranges[j] * table[j, 0], ranges[j] * table[j, 1]
    half = 0.5 * (last - first + 1) * step
    chord = math.hypot(bx - ax, by - ay) + step * cluster[NEAR]
    if half > 1.3 or chord > 2.0 * LARGEST_M:
        return False
    radius = min(0.5 * chord / math.cos(half), chord)
    cluster[RADIUS] = radius
    cluster[SIGMA] = 0.02 + 0.3 * step * cluster[NEAR]
    cluster[FROM] = sensor[2] + limits[0] + limits[1] * (first - 0.5)
    cluster[TO] = sensor[2] + limits[0] + limits[1] * (last + 0.5)
    x, y, _ = centre(cluster, radius, sensor)
    cluster[CX], cluster[CY] = x, y
    c, s = math.cos(sensor[2]), math.sin(sensor[2])
    for k in range(3):
        m = first + ((2 * k + 1) * (last - first)) // 6
        while not _hit(ranges[m % n], limits):
            m += 1
        px, py = ranges[m % n] * table[m % n, 0], ranges[m % n] * table[m % n, 1]
        cluster[POINTS + 2 * k] = sensor[0] + c * px - s * py
        cluster[POINTS + 2 * k + 1] = sensor[1] + s * px + c * py
    return True


@kernel
def centre(cluster: Array, radius: float, sensor: Pose) -> Tuple[float, float, float]:
    """Return the centre (x, y) and its standard deviation [m] of a disc of this radius from its visible part.

    If the next beam beyond an edge reaches farther, the edge is a true one. If the other edge is occluded, the
    centre is placed one radius inward from the visible edge.
    """
    distance = cluster[NEAR] + radius
    half = math.asin(min(radius / distance, 1.0))
    bearing, sigma = 0.5 * (cluster[FROM] + cluster[TO]), cluster[SIGMA]
    if cluster[HIDDEN_FROM] + cluster[HIDDEN_TO] > 0.0:
        seen = 0.5 * abs(cluster[TO] - cluster[FROM])
        sigma += 0.05 + 0.5 * max(half - seen, 0.0) * distance
        if half > seen and cluster[HIDDEN_FROM] != cluster[HIDDEN_TO]:
            beside = math.copysign(half, cluster[TO] - cluster[FROM])
            bearing = cluster[FROM] + beside if cluster[HIDDEN_TO] > 0.0 else cluster[TO] - beside
    return sensor[0] + distance * math.cos(bearing), sensor[1] + distance * math.sin(bearing), sigma
