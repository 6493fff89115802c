"""Correction of the laser's pose: the small shift and turn that fit a scan to static tracks.

The odometry is wrong if the base skids or its wheels spin. All static obstacles then seem to move.
The correction is a robust weighted least-squares fit to the positions of the static tracks. It
covers what the matched poses of the monitor leave open: the slip within one scan, that among a few
posts, which are too few beams to match, and that of a tracker without a monitor.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.movers.clusters import POINTS, Clusters
from applr_ros1.movers.free_space import Fan

VOTES = 3  # smallest number of static tracks (votes) for a correction
# Expected errors of the odometry from scan to scan.
SHIFT_M = 0.03
TURN_RAD = 0.01
FITS_M = 0.04  # residual at which a track has half the weight [m]
ROUNDS = 4  # iterations of the robust fit
AGREE_SHARE = 0.6  # share of the tracks that must fit the correction

# A static track: its position x, y [m], the variance of it [m^2], and the index of its cluster.
VOTER = np.dtype(
    [("x", np.float64), ("y", np.float64), ("variance", np.float64), ("cluster", np.int64)]
)
Voters = Any  # an array (n,) of records of VOTER, which numba knows by its dtype


class Correction(NamedTuple):
    """Correction of a laser's pose: shift dx, dy [m] in the fixed frame, and turn [rad]."""

    dx: float
    dy: float
    turn: float


NONE = Correction(0.0, 0.0, 0.0)


@kernel
def slip(voters: Voters, clusters: Clusters, fan: Fan) -> Correction:
    """Return the correction of the laser's pose, zeros if too few static tracks agree.

    Each round solves the normal equations A (dx, dy, turn) = b, in which a point at x, y from the
    laser moves by dx - turn y, dy + turn x.

    Args:
        voters: (n,) VOTERs.
        clusters: (m,) CLUSTERs of the scan.
        fan: FAN of the scan, with the pose of the laser according to the odometry.
    """
    voter_count = voters.shape[0]
    if voter_count < VOTES:
        return NONE
    dx = 0.0
    dy = 0.0
    turn = 0.0
    fitting_sum = 0.0
    for _ in range(ROUNDS):
        # The odometry is a prior of zero correction.
        a00 = 1.0 / SHIFT_M**2
        a11 = a00
        a22 = 1.0 / TURN_RAD**2
        a02 = 0.0
        a12 = 0.0
        b0 = 0.0
        b1 = 0.0
        b2 = 0.0
        fitting_sum = 0.0
        for voter in voters:
            cluster = clusters[voter.cluster]
            x = cluster.x - fan.x
            y = cluster.y - fan.y
            error_x = voter.x - cluster.x
            error_y = voter.y - cluster.y
            rest_x = error_x - dx + turn * y
            rest_y = error_y - dy - turn * x

            # Weight of Cauchy: outliers, such as obstacles that begin to move, count little.
            residual = (rest_x**2 + rest_y**2) / FITS_M**2
            fitting_sum += 1.0 / (1.0 + residual)
            weight = 1.0 / ((voter.variance + cluster.sigma**2) * (1.0 + residual))
            a00 += weight
            a11 += weight
            a22 += weight * (x * x + y * y)
            a02 -= weight * y
            a12 += weight * x
            b0 += weight * error_x
            b1 += weight * error_y
            b2 += weight * (x * error_y - y * error_x)

        # A has no entry for dx with dy, so both are eliminated from the last row.
        turn_numerator = b2 - a02 * b0 / a00 - a12 * b1 / a11
        turn = turn_numerator / (a22 - a02 * a02 / a00 - a12 * a12 / a11)
        dx = (b0 - a02 * turn) / a00
        dy = (b1 - a12 * turn) / a11
    if fitting_sum < AGREE_SHARE * voter_count:
        return NONE
    return Correction(dx, dy, turn)


@kernel
def shift(clusters: Clusters, fan: Fan, correction: Correction) -> None:
    """Apply a correction to the clusters (n,) and the FAN of a scan in place."""
    cos_turn = math.cos(correction.turn)
    sin_turn = math.sin(correction.turn)
    moved_x = fan.x + correction.dx
    moved_y = fan.y + correction.dy
    for cluster in clusters:
        cluster.start += correction.turn
        cluster.end += correction.turn
        x = cluster.x - fan.x
        y = cluster.y - fan.y
        cluster.x = moved_x + cos_turn * x - sin_turn * y
        cluster.y = moved_y + sin_turn * x + cos_turn * y
        for index in range(POINTS):
            x = cluster.points[index, 0] - fan.x
            y = cluster.points[index, 1] - fan.y
            cluster.points[index, 0] = moved_x + cos_turn * x - sin_turn * y
            cluster.points[index, 1] = moved_y + sin_turn * x + cos_turn * y
    fan.x = moved_x
    fan.y = moved_y
    fan.yaw += correction.turn
