"""Neighbouring points of a scan that belong together: clusters, and the disc that each may be part of.

MoverTracker calls find_clusters for each scan; tracks.py asks for a cluster's centre once it knows a disc's radius.
"""

import math

from applr_ros1.common.kernels import kernel
from applr_ros1.movers.free_space import full_turn

MAX_CLUSTERS = 256
# columns of a cluster: raw centre [m], radius [m], nearest range [m], bearings of its edges in the fixed frame [rad]
# (first beam's, last beam's), whether something nearer, or nothing known, hides what is beyond each edge, standard
# deviation of the centre [m], and three of its points [m]
CX, CY, RADIUS, NEAR, FROM, TO, HIDDEN_FROM, HIDDEN_TO, SIGMA, POINTS = range(10)
COLUMNS = POINTS + 6

# [rad]: a surface seen under less than this angle falls apart (Borges and Aldon, J. Int. Rob. Sys. 2004)
GRAZING_RAD = 0.2
APART_M = 0.08  # [m] between neighbouring points of a cluster that is always allowed: noise
GAP_BEAMS = 3  # beams from one point of a cluster to the next at most
FEWEST_POINTS = 3  # points of a cluster


@kernel
def find_clusters(ranges, table, limits, sensor, largest, reach, clusters):
    """Fill `clusters` (MAX_CLUSTERS, COLUMNS) from a scan; returns how many there are.

    Args:
        ranges: (n,) float32 [m].
        table: (n, 2) cosine and sine of the beams.
        limits: first angle, increment [rad], range_min, range_max [m].
        sensor: pose (x, y, yaw) of the laser in the fixed frame.
        largest: radius [m] beyond which a cluster is left out.
        reach: range [m] beyond which it is left out.
        clusters: as COLUMNS say.
    """
    n = ranges.shape[0]
    step = abs(limits[1])
    widen = math.sin(step) / math.sin(max(GRAZING_RAD - step, 0.02))
    full = full_turn(n, step)
    begin = 0  # a beam after which a cluster may begin: on a full turn one may lie across its ends
    while full and begin < n - 1 and _joined(ranges, table, limits, begin - 1, begin, widen):
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
            while k < min(last + GAP_BEAMS, begin + n) and not _joined(ranges, table, limits, last, k, widen):
                k += 1
            if k >= begin + n or not _joined(ranges, table, limits, last, k, widen):
                break
            last = k
            points += 1
            near = min(near, ranges[k % n])
        k = last + 1
        if points >= FEWEST_POINTS and near < reach:
            cluster = clusters[count]
            cluster[NEAR] = near
            cluster[HIDDEN_FROM] = _hides(ranges, limits, first, -1, full)
            cluster[HIDDEN_TO] = _hides(ranges, limits, last, 1, full)
            if _measure(ranges, table, limits, sensor, first, last, largest, cluster):
                count += 1
    return count


@kernel
def _hit(r, limits):
    return limits[2] <= r < limits[3]


@kernel
def _joined(ranges, table, limits, a, b, widen):
    """Return whether the points of beams a and b belong to one surface."""
    n = ranges.shape[0]
    i, j = a % n, b % n
    r, q = ranges[i], ranges[j]
    if not (_hit(r, limits) and _hit(q, limits)):
        return False
    dx, dy = r * table[i, 0] - q * table[j, 0], r * table[i, 1] - q * table[j, 1]
    apart = APART_M + (b - a) * widen * min(r, q)
    return dx * dx + dy * dy < apart * apart


@kernel
def _hides(ranges, limits, edge, way, full):
    """Return whether what is beyond a cluster's last beam on one side hides more of it."""
    n = ranges.shape[0]
    beyond = edge + way
    if not full and not 0 <= beyond < n:
        return 1.0
    r = ranges[beyond % n]
    return 0.0 if r >= ranges[edge % n] else 1.0  # nearer, NaN or too near to tell


@kernel
def _measure(ranges, table, limits, sensor, first, last, largest, cluster):
    """Fill in the disc of the beams from first to last; return False if it is larger than `largest`."""
    n = ranges.shape[0]
    step = abs(limits[1])
    i, j = first % n, last % n
    ax, ay = ranges[i] * table[i, 0], ranges[i] * table[i, 1]
    bx, by = ranges[j] * table[j, 0], ranges[j] * table[j, 1]
    half = 0.5 * (last - first + 1) * step
    chord = math.hypot(bx - ax, by - ay) + step * cluster[NEAR]
    if half > 1.3 or chord > 2.0 * largest:
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
def centre(cluster, radius, sensor):
    """Return the centre (x, y) [m] of a disc of this radius whose visible part is a cluster; its standard deviation.

    An edge beyond which the laser sees farther is the disc's edge; where the other one is hidden, the centre lies so
    far beside the visible one as the radius says.
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
