"""Correction of the laser's pose: the small shift and turn that fit a scan to the tracks of static obstacles.

The odometry is wrong if the base skids or its wheels spin. All static obstacles then seem to move. The correction is a
robust weighted least-squares fit to the positions of the static tracks.
"""

import math

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array, Ints
from applr_ros1.common.kernels import kernel
from applr_ros1.movers.clusters import CX, CY, FROM, POINTS, SIGMA, TO

VOTES = 3  # smallest number of static tracks (votes) for a correction
SHIFT_M, TURN_RAD = 0.03, 0.01  # expected errors of the odometry from scan to scan [m, rad]
FITS_M = 0.04  # residual at which a track has half the weight [m]
ROUNDS = 4  # iterations of the robust fit
AGREE_SHARE = 0.6  # share of the tracks that must fit the correction


@kernel
def slip(places: Array, voters: Ints, votes: int, clusters: Array, sensor: Pose) -> Pose:
    """Return the correction (dx, dy [m], turn [rad]) of the laser's pose, or zeros if too few static tracks agree.

    Args:
        places: (at least `votes`, 3) x, y [m] and variance [m^2] of the static tracks.
        voters: (at least `votes`,) index of each static track's cluster.
        votes: number of static tracks.
        clusters: (n, COLUMNS) as in clusters.py.
        sensor: (x, y, yaw) of the laser according to the odometry [m, rad].
    """
    dx = dy = turn = fitting = 0.0
    if votes < VOTES:
        return dx, dy, turn
    for _ in range(ROUNDS):
        a00 = a11 = 1.0 / SHIFT_M**2
        a22 = 1.0 / TURN_RAD**2
        a02 = a12 = b0 = b1 = b2 = fitting = 0.0
        for k in range(votes):
            cluster = clusters[voters[k]]
            x, y = cluster[CX] - sensor[0], cluster[CY] - sensor[1]
            ex, ey = places[k, 0] - cluster[CX], places[k, 1] - cluster[CY]
            off = ((ex - dx + turn * y) ** 2 + (ey - dy - turn * x) ** 2) / FITS_M**2
            fitting += 1.0 / (1.0 + off)
            w = 1.0 / ((places[k, 2] + cluster[SIGMA] ** 2) * (1.0 + off))
            a00 += w
            a11 += w
            a22 += w * (x * x + y * y)
            a02 -= w * y
            a12 += w * x
            b0 += w * ex
            b1 += w * ey
            b2 += w * (x * ey - y * ex)
        turn = (b2 - a02 * b0 / a00 - a12 * b1 / a11) / (a22 - a02 * a02 / a00 - a12 * a12 / a11)
        dx, dy = (b0 - a02 * turn) / a00, (b1 - a12 * turn) / a11
    if fitting < AGREE_SHARE * votes:
        return 0.0, 0.0, 0.0
    return dx, dy, turn


@kernel
def shift(clusters: Array, fan: Array, sensor: Pose, by: Pose) -> Pose:
    """Apply the correction `by` to clusters and `fan` of a scan in place, and return the corrected pose (x, y, yaw)."""
    dx, dy, turn = by
    c, s = math.cos(turn), math.sin(turn)
    for cluster in clusters:
        cluster[FROM] += turn
        cluster[TO] += turn
        for i in (CX, POINTS, POINTS + 2, POINTS + 4):
            x, y = cluster[i] - sensor[0], cluster[i + 1] - sensor[1]
            cluster[i] = sensor[0] + dx + c * x - s * y
            cluster[i + 1] = sensor[1] + dy + s * x + c * y
    pose = sensor[0] + dx, sensor[1] + dy, sensor[2] + turn
    fan[1], fan[2], fan[3] = pose
    return pose
