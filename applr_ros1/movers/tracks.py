"""Tracks: clusters followed from scan to scan, with the evidence that they move. MoverTracker holds them in an array.

Each small cluster has a track with a constant-velocity Kalman filter, whose covariance is the same along x and y
(Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 6.2). A track
is a moving obstacle once its velocity differs clearly from zero and free space proves its motion (free_space.py): an
earlier scan saw through its position, or the current scan sees through its previous position.
"""

import math
from typing import Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array, Array32, Ints
from applr_ros1.common.kernels import kernel
from applr_ros1.movers.clusters import HIDDEN_FROM, HIDDEN_TO, POINTS, RADIUS, centre
from applr_ros1.movers.free_space import RATE, SCANS, STAMP, SWEPT, sees_through
from applr_ros1.movers.slip import VOTES, shift, slip

MAX_TRACKS = 192  # largest number of tracks
# Columns of a track. ID: identifier, 0 for an empty row. TX, TY: centre [m]. VX, VY: velocity [m/s]. PP, PV, VV:
# variance of the position, covariance of position and velocity, variance of the velocity. TR: radius [m]. BORN, SEEN,
# EVIDENT: stamps of the first cluster, the last cluster, the last evidence of motion [s]. EVIDENCE, TIMES: duration
# [s] and number of scans of the evidence. GONE: number of scans that saw through the track. MOVES: 1 for a moving
# obstacle. HITS: number of clusters. MX, MY: moving average of the centre [m].
(
    ID,
    TX,
    TY,
    VX,
    VY,
    PP,
    PV,
    VV,
    TR,
    BORN,
    SEEN,
    EVIDENT,
    EVIDENCE,
    TIMES,
    GONE,
    MOVES,
    HITS,
    MX,
    MY,
) = range(19)
COLUMNS = 19

ACCELERATION = 0.2  # spectral density of the acceleration [m^2/s^3]
BEARING_RAD = 0.005  # standard deviation of a bearing in the odometry's frame [rad]
LATENCY_S = 0.04  # largest offset between the stamps of scan and pose [s]; shifts bearings when the turn rate changes
BENT_RAD = (
    0.15  # turn of the robot during a scan above which the scan gives no evidence of motion [rad]
)
FIRST_SPEED_M_S = 1.5  # standard deviation of the velocity of a new track [m/s]
GATE = 9.0  # association gate: largest squared normalised distance of a cluster from a track
SUDDEN_M_S = 1.0  # change of velocity from scan to scan that the gate allows [m/s]
FARTHEST_M = 1.0  # largest distance of a cluster from its track along x and y [m]
RESIZED_M = (
    0.15  # difference of the radii of cluster and track that counts as one standard deviation [m]
)
# Speed above which a track may be a moving obstacle, and below which it no longer is one [m/s].
SLOWEST_M_S, STANDING_M_S = 0.25, 0.12
CLEAR_DEVIATIONS = 2.0  # number of standard deviations by which a velocity must differ from zero
ENOUGH_S, ENOUGH_SCANS = (
    0.12,
    2,
)  # evidence that makes a track a moving obstacle: duration [s], number of scans
MOST_EVIDENCE_S = 0.5  # largest accumulated evidence [s]
SAME_SIZE_M = 0.03  # largest difference between a track's and its cluster's radii, to correct the laser's pose [m]
SETTLED_HITS = 3  # smallest number of scans in which a static track had a cluster, before it corrects the laser's pose
AVERAGED_S = 0.5  # averaging time of the position of a static track [s]
SLIDES_M_S = 0.2  # largest lateral slip of a base that turns or brakes [m/s]
SILENT_S = 1.0  # time without evidence after which a track is no longer a moving obstacle [s]
HIDDEN_S = 0.8  # time for which an occluded moving obstacle is extrapolated [s]
LOST_S = 0.25  # time without a cluster after which a static track ends [s]
Scans = Tuple[
    Array32, Array
]  # earlier scans in FreeSpace: free depths (SCANS, n) [m], geometry (SCANS, 10)


@kernel
def predict(tracks: Array, dt: float) -> None:
    """Predict all tracks dt [s] ahead."""
    q = ACCELERATION
    for t in range(tracks.shape[0]):
        row = tracks[t]
        if row[ID] > 0.0:
            row[TX] += row[VX] * dt
            row[TY] += row[VY] * dt
            row[PP] += dt * (2.0 * row[PV] + dt * row[VV]) + q * dt * dt * dt / 3.0
            row[PV] += dt * row[VV] + 0.5 * q * dt * dt
            row[VV] += q * dt


@kernel
def associate(tracks: Array, clusters: Array, sensor: Pose, dt: float) -> Tuple[Ints, np.ndarray]:
    """Assign clusters to tracks, the nearest pairs first.

    Returns:
        (MAX_TRACKS,) cluster index of each track, or -1; (n,) whether each cluster has a track.
    """
    cluster_of = np.full(MAX_TRACKS, -1)
    costs = np.empty(4 * MAX_TRACKS)
    pairs = np.empty((4 * MAX_TRACKS, 2), np.int64)
    n = 0
    for t in range(tracks.shape[0]):
        row = tracks[t]
        if row[ID] == 0.0:
            continue
        for c in range(clusters.shape[0]):
            if (
                abs(clusters[c, 0] - row[TX]) > FARTHEST_M
                or abs(clusters[c, 1] - row[TY]) > FARTHEST_M
            ):
                continue
            x, y, sigma = centre(clusters[c], row[TR], sensor)
            dx, dy = x - row[TX], y - row[TY]
            cost = (dx * dx + dy * dy) / (row[PP] + sigma * sigma + (SUDDEN_M_S * dt) ** 2)
            larger = clusters[c, RADIUS] - row[TR]
            if larger > 0.0 or clusters[c, HIDDEN_FROM] + clusters[c, HIDDEN_TO] == 0.0:
                cost += (larger / RESIZED_M) ** 2
            if cost < GATE and n < costs.shape[0]:
                costs[n], pairs[n, 0], pairs[n, 1] = cost, t, c
                n += 1
    taken = np.zeros(clusters.shape[0], np.bool_)
    for k in np.argsort(costs[:n]):
        t, c = pairs[k, 0], pairs[k, 1]
        if cluster_of[t] < 0 and not taken[c]:
            cluster_of[t] = c
            taken[c] = True
    return cluster_of, taken


@kernel
def correct(row: Array, cluster: Array, sensor: Pose, dt: float) -> None:
    """Update a track's row with the position and size of its cluster, dt [s] after the previous update."""
    radius = cluster[RADIUS]
    if cluster[HIDDEN_FROM] + cluster[HIDDEN_TO] > 0.0:
        row[TR] = max(row[TR], radius)
    else:
        row[TR] += 0.2 * (radius - row[TR])
    x, y, sigma = centre(cluster, row[TR], sensor)
    row[HITS] += 1.0
    share = max(1.0 / (row[HITS] + 1.0), min(dt / AVERAGED_S, 0.5))
    row[MX] += share * (x - row[MX])
    row[MY] += share * (y - row[MY])
    lever = BEARING_RAD * math.hypot(x - sensor[0], y - sensor[1])
    variance = row[PP] + sigma * sigma + lever * lever
    k, kv = row[PP] / variance, row[PV] / variance
    dx, dy = x - row[TX], y - row[TY]
    row[TX] += k * dx
    row[TY] += k * dy
    row[VX] += kv * dx
    row[VY] += kv * dy
    row[VV] -= kv * row[PV]
    row[PV] *= 1.0 - k
    row[PP] *= 1.0 - k


@kernel
def has_moved(points: Array, history: Array, before: Scans, depth: Array32, fan: Array) -> bool:
    """Return whether an earlier scan saw through a cluster's points, or the latest sees through their old positions.

    Args:
        points: (6,) three points of the cluster [m].
        history: (SCANS, 6) positions of the points in the earlier scans [m]; NaN if the track had no cluster.
        before: earlier scans in FreeSpace.
        depth: (n,) free depth of the latest scan's beams [m].
        fan: (10,) geometry of the latest scan.
    """
    ranges, fans = before
    for s in range(SCANS):
        swept = max(fan[SWEPT], fans[s, SWEPT])
        if fans[s, STAMP] == -math.inf or swept > BENT_RAD:
            continue
        came = left = 0
        turned = LATENCY_S * abs(fan[RATE] - fans[s, RATE]) + swept
        for k in range(0, 6, 2):
            came += sees_through(ranges[s], fans[s], points[k], points[k + 1], turned)
            if not math.isnan(history[s, k]):
                left += sees_through(depth, fan, history[s, k], history[s, k + 1], turned)
        if came >= 2 or left >= 2:
            return True
    return False


@kernel
def follow(
    tracks: Array,
    history: Array,
    clusters: Array,
    scan: Tuple[Array32, Array, Pose],
    before: Scans,
    dt: float,
    speed: float,
) -> Tuple[Ints, np.ndarray, Pose]:
    """Correct the laser's pose, apply the correction to `clusters` and `fan` in place, and update all tracks.

    Args:
        tracks: (MAX_TRACKS, COLUMNS).
        history: (SCANS, MAX_TRACKS, 6) points of each track's cluster in the earlier scans [m].
        clusters: (n, clusters.COLUMNS) clusters of the scan.
        scan: free depth of the beams (n,) [m], fan (10,) with their geometry (free_space.py), and pose of the laser.
        before: earlier scans in FreeSpace.
        dt: time since the last scan [s].
        speed: speed of the laser according to the odometry [m/s].

    Returns:
        Both arrays of `associate`, and the corrected pose of the laser.
    """
    depth, fan, sensor = scan
    now = fan[STAMP]
    predict(tracks, dt)
    cluster_of, taken = associate(tracks, clusters, sensor, dt)
    sensor = _correct_pose(tracks, clusters, cluster_of, fan, sensor)
    for t in range(tracks.shape[0]):
        if cluster_of[t] >= 0:
            correct(tracks[t], clusters[cluster_of[t]], sensor, dt)
    drift_x, drift_y = _drift(tracks, cluster_of, speed)
    for t in range(tracks.shape[0]):
        row = tracks[t]
        if row[ID] == 0.0:
            continue
        if cluster_of[t] < 0:
            row[GONE] += sees_through(depth, fan, row[TX], row[TY], 0.0)
            if row[GONE] >= 2.0 or now - row[SEEN] > (HIDDEN_S if row[MOVES] > 0.0 else LOST_S):
                row[:] = 0.0
                history[:, t] = math.nan
            continue
        row[SEEN], row[GONE] = now, 0.0
        speed_seen = math.hypot(row[VX], row[VY])
        if speed_seen < STANDING_M_S:
            row[MOVES] = row[EVIDENCE] = row[TIMES] = 0.0
        clear = max(SLOWEST_M_S, CLEAR_DEVIATIONS * math.sqrt(row[VV]))
        if speed_seen > clear and math.hypot(row[VX] - drift_x, row[VY] - drift_y) > clear:
            if has_moved(clusters[cluster_of[t], POINTS:], history[:, t], before, depth, fan):
                row[EVIDENCE] = min(row[EVIDENCE] + dt, MOST_EVIDENCE_S)
                row[TIMES] += 1.0
                row[EVIDENT] = now
                if row[EVIDENCE] >= ENOUGH_S and row[TIMES] >= ENOUGH_SCANS:
                    row[MOVES] = 1.0
            else:
                row[EVIDENCE] = max(row[EVIDENCE] - dt, 0.0)
        if now - row[EVIDENT] > SILENT_S:
            row[MOVES] = row[EVIDENCE] = row[TIMES] = 0.0
    return cluster_of, taken, sensor


@kernel
def _correct_pose(
    tracks: Array, clusters: Array, cluster_of: Ints, fan: Array, sensor: Pose
) -> Pose:
    places, voters, votes = np.empty((MAX_TRACKS, 3)), np.empty(MAX_TRACKS, np.int64), 0
    for t in range(tracks.shape[0]):
        row, c = tracks[t], cluster_of[t]
        if (
            c < 0
            or row[MOVES] > 0.0
            or math.hypot(row[VX], row[VY]) > SLOWEST_M_S
            or row[HITS] < SETTLED_HITS
        ):
            continue
        cluster = clusters[c]
        if (
            cluster[HIDDEN_FROM] + cluster[HIDDEN_TO] == 0.0
            and abs(cluster[RADIUS] - row[TR]) < SAME_SIZE_M
        ):
            places[votes, 0], places[votes, 1], places[votes, 2] = row[MX], row[MY], row[PP]
            voters[votes] = c
            votes += 1
    corrected: Pose = shift(clusters, fan, sensor, slip(places, voters, votes, clusters, sensor))
    return corrected


@kernel
def _drift(tracks: Array, cluster_of: Ints, speed: float) -> Tuple[float, float]:
    """Return the median velocity (x, y) [m/s] of the static tracks if wheel slip can explain it, else zeros."""
    n, vx, vy = 0, np.empty(MAX_TRACKS), np.empty(MAX_TRACKS)
    for t in range(tracks.shape[0]):
        if cluster_of[t] >= 0 and tracks[t, MOVES] == 0.0 and tracks[t, HITS] >= SETTLED_HITS:
            vx[n], vy[n] = tracks[t, VX], tracks[t, VY]
            n += 1
    if n < VOTES:
        return 0.0, 0.0
    x, y = np.median(vx[:n]), np.median(vy[:n])
    return (x, y) if math.hypot(x, y) < speed + SLIDES_M_S else (0.0, 0.0)


@kernel
def begin(tracks: Array, clusters: Array, taken: np.ndarray, now: float, number: int) -> int:
    """Start a track for each unassigned cluster, unless it overlaps a moving obstacle. Return the next free ID."""
    t = 0
    for c in range(clusters.shape[0]):
        if taken[c]:
            continue
        x, y, radius = clusters[c, 0], clusters[c, 1], clusters[c, RADIUS]
        known = False
        for k in range(tracks.shape[0]):
            if (
                tracks[k, MOVES] > 0.0
                and math.hypot(tracks[k, TX] - x, tracks[k, TY] - y) < tracks[k, TR] + radius
            ):
                known = True
        while t < tracks.shape[0] and tracks[t, ID] > 0.0:
            t += 1
        if t == tracks.shape[0]:
            break
        if known:
            continue
        row = tracks[t]
        row[:] = 0.0
        row[ID], row[TX], row[TY], row[TR], row[BORN], row[SEEN] = number, x, y, radius, now, now
        row[MX], row[MY] = x, y
        row[PP], row[VV], row[EVIDENT] = 0.1**2, FIRST_SPEED_M_S**2, now
        number += 1
    return number


@kernel
def remember(history: Array, slot: int, cluster_of: Ints, clusters: Array) -> None:
    """Store the points of each track's cluster for the scan that FreeSpace keeps in row `slot`."""
    for t in range(cluster_of.shape[0]):
        if cluster_of[t] >= 0:
            history[slot, t] = clusters[cluster_of[t], POINTS : POINTS + 6]
        else:
            history[slot, t] = math.nan
