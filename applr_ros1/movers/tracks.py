"""Tracks: clusters followed from scan to scan, and the evidence that one moves. MoverTracker holds the arrays.

Each small cluster has a track with a Kalman filter of constant velocity, whose covariance is the same along x and y
(Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 6.2). A track
is a mover once its velocity differs clearly from zero, and scans say so (free_space.py): it is where earlier ones saw
through, or the present one sees through where it was.
"""

import math

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.movers.clusters import HIDDEN_FROM, HIDDEN_TO, MAX_CLUSTERS, POINTS, RADIUS, centre
from applr_ros1.movers.free_space import RATE, SCANS, STAMP, SWEPT, sees_through
from applr_ros1.movers.slip import VOTES, shift, slip

MAX_TRACKS = 192
# columns of a track: number (0: none), centre [m], velocity [m/s], variances of place, both, velocity, radius [m],
# stamps of its first and last cluster and of the last evidence [s], evidence [s], how often, scans that saw through it,
# whether it is a mover, clusters so far, and the mean of its last centres [m]
ID, TX, TY, VX, VY, PP, PV, VV, TR, BORN, SEEN, EVIDENT, EVIDENCE, TIMES, GONE, MOVES, HITS, MX, MY = range(19)
COLUMNS = 19

ACCELERATION = 0.2  # [m^2/s^3]: spectral density of the acceleration
BEARING_RAD = 0.005  # [rad]: standard deviation of a bearing in the odometry's frame
LATENCY_S = 0.04  # [s] by which stamps of scans and poses may differ: bearings err where the robot's turn changes
BENT_RAD = 0.15  # [rad]: scans during which the robot turns by more show nothing that moves
FIRST_SPEED_M_S = 1.5  # [m/s]: standard deviation of the velocity of a new track
GATE = 9.0  # squared deviations up to which a cluster may be a track's
SUDDEN_M_S = 1.0  # [m/s] by which a velocity may change from scan to scan
FARTHEST_M = 1.0  # [m] between both at most
RESIZED_M = 0.15  # [m]: a difference of both radii that counts as one deviation
SLOWEST_M_S, STANDING_M_S = 0.25, 0.12  # [m/s]: what is faster may be a mover, what becomes slower is none any more
CLEAR_DEVIATIONS = 2.0  # deviations by which a mover's velocity differs from zero
ENOUGH_S, ENOUGH_SCANS = 0.12, 2  # evidence [s], and in how many scans, that makes a mover
MOST_EVIDENCE_S = 0.5  # [s] of evidence that counts
SAME_SIZE_M = 0.03  # [m]: of a cluster and a track, for that
SETTLED_HITS = 3  # clusters after which a track that stands tells where the robot is
AVERAGED_S = 0.5  # [s] over which its place is averaged for that
SLIDES_M_S = 0.2  # [m/s]: a base that turns or brakes may slide so fast beside what its wheels say
SILENT_S = 1.0  # [s] after which a mover needs new evidence
HIDDEN_S = 0.8  # [s] for which a mover that is hidden is carried on
LOST_S = 0.25  # [s] after which another track ends without a cluster


@kernel
def predict(tracks, dt):
    """Carry all tracks on by dt [s]."""
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
def associate(tracks, clusters, count, sensor, dt, found):
    """Fill found (MAX_TRACKS,) with the number of each track's cluster, -1 without one: the nearest pairs first."""
    costs = np.empty(4 * MAX_TRACKS)
    pairs = np.empty((4 * MAX_TRACKS, 2), np.int64)
    n = 0
    for t in range(tracks.shape[0]):
        found[t] = -1
        row = tracks[t]
        if row[ID] == 0.0:
            continue
        for c in range(count):
            if abs(clusters[c, 0] - row[TX]) > FARTHEST_M or abs(clusters[c, 1] - row[TY]) > FARTHEST_M:
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
    taken = np.zeros(MAX_CLUSTERS, np.bool_)
    for k in np.argsort(costs[:n]):
        t, c = pairs[k, 0], pairs[k, 1]
        if found[t] < 0 and not taken[c]:
            found[t] = c
            taken[c] = True
    return taken


@kernel
def correct(row, cluster, sensor, dt):
    """Give a track's row a cluster's place and size, dt [s] after the last one."""
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
def has_moved(points, history, ranges, fans, depth, fan):
    """Return whether a cluster's points (6,) are where a scan saw through, or the newest sees through where they were.

    history: (SCANS, 6), NaN where there was no cluster; ranges, fans: FreeSpace's; depth, fan: of the newest scan.
    """
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
def follow(tracks, history, clusters, count, scan, before, dt, speed):
    """One scan's step of all tracks.

    Args:
        tracks: (MAX_TRACKS, COLUMNS).
        history: (SCANS, MAX_TRACKS, 6): the points of each track's cluster in the kept scans.
        clusters: of the scan.
        count: how many there are.
        scan: how far its beams saw (n,), its fan (10,), the laser's pose.
        before: FreeSpace's ranges and fans.
        dt: since the last scan [s].
        speed: of the laser by the odometry [m/s].

    Returns:
        (MAX_TRACKS,) the number of each track's cluster, -1 without one; (MAX_CLUSTERS,) which clusters have a track;
        the laser's pose as what stands has it. Clusters and fan are corrected by it in place.
    """
    depth, fan, sensor = scan
    ranges, fans = before
    now = fan[STAMP]
    found = np.empty(MAX_TRACKS, np.int64)
    predict(tracks, dt)
    taken = associate(tracks, clusters, count, sensor, dt, found)
    sensor = _correct_pose(tracks, clusters, count, found, fan, sensor)
    for t in range(tracks.shape[0]):
        if found[t] >= 0:
            correct(tracks[t], clusters[found[t]], sensor, dt)
    drift_x, drift_y = _drift(tracks, found, speed)
    for t in range(tracks.shape[0]):
        row = tracks[t]
        if row[ID] == 0.0:
            continue
        if found[t] < 0:
            row[GONE] += sees_through(depth, fan, row[TX], row[TY], 0.0)
            if row[GONE] >= 2.0 or now - row[SEEN] > (HIDDEN_S if row[MOVES] > 0.0 else LOST_S):
                _end(row, history, t)
            continue
        row[SEEN], row[GONE] = now, 0.0
        speed_seen = math.hypot(row[VX], row[VY])
        if speed_seen < STANDING_M_S:
            row[MOVES] = row[EVIDENCE] = row[TIMES] = 0.0
        clear = max(SLOWEST_M_S, CLEAR_DEVIATIONS * math.sqrt(row[VV]))
        if speed_seen > clear and math.hypot(row[VX] - drift_x, row[VY] - drift_y) > clear:
            if has_moved(clusters[found[t], POINTS:], history[:, t], ranges, fans, depth, fan):
                row[EVIDENCE] = min(row[EVIDENCE] + dt, MOST_EVIDENCE_S)
                row[TIMES] += 1.0
                row[EVIDENT] = now
                if row[EVIDENCE] >= ENOUGH_S and row[TIMES] >= ENOUGH_SCANS:
                    row[MOVES] = 1.0
            else:
                row[EVIDENCE] = max(row[EVIDENCE] - dt, 0.0)
        if now - row[EVIDENT] > SILENT_S:
            row[MOVES] = row[EVIDENCE] = row[TIMES] = 0.0
    return found, taken, sensor


@kernel
def _correct_pose(tracks, clusters, count, found, fan, sensor):
    places, voters, votes = np.empty((MAX_TRACKS, 3)), np.empty(MAX_TRACKS, np.int64), 0
    for t in range(tracks.shape[0]):
        row = tracks[t]
        if found[t] < 0 or row[MOVES] > 0.0 or math.hypot(row[VX], row[VY]) > SLOWEST_M_S or row[HITS] < SETTLED_HITS:
            continue
        cluster = clusters[found[t]]
        if cluster[HIDDEN_FROM] + cluster[HIDDEN_TO] == 0.0 and abs(cluster[RADIUS] - row[TR]) < SAME_SIZE_M:
            places[votes, 0], places[votes, 1], places[votes, 2] = row[MX], row[MY], row[PP]
            voters[votes] = found[t]
            votes += 1
    return shift(clusters, count, fan, sensor, slip(places, voters, votes, clusters, sensor))


@kernel
def _drift(tracks, found, speed):
    """Return the velocity (x, y) [m/s] with which all but movers seems to move, if wheels that slip can be why."""
    n, vx, vy = 0, np.empty(MAX_TRACKS), np.empty(MAX_TRACKS)
    for t in range(tracks.shape[0]):
        if found[t] >= 0 and tracks[t, MOVES] == 0.0 and tracks[t, HITS] >= SETTLED_HITS:
            vx[n], vy[n] = tracks[t, VX], tracks[t, VY]
            n += 1
    if n < VOTES:
        return 0.0, 0.0
    x, y = np.median(vx[:n]), np.median(vy[:n])
    return (x, y) if math.hypot(x, y) < speed + SLIDES_M_S else (0.0, 0.0)


@kernel
def _end(row, history, t):
    row[:] = 0.0
    history[:, t] = math.nan


@kernel
def begin(tracks, clusters, count, taken, now, number):
    """New tracks for the clusters that have none, unless a mover hides there already; returns the next number."""
    t = 0
    for c in range(count):
        if taken[c]:
            continue
        x, y, radius = clusters[c, 0], clusters[c, 1], clusters[c, RADIUS]
        known = False
        for k in range(tracks.shape[0]):
            if tracks[k, MOVES] > 0.0 and math.hypot(tracks[k, TX] - x, tracks[k, TY] - y) < tracks[k, TR] + radius:
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
def remember(history, slot, found, clusters):
    """Keep the points of each track's cluster for the scan that FreeSpace keeps in row `slot`."""
    for t in range(found.shape[0]):
        if found[t] >= 0:
            history[slot, t] = clusters[found[t], POINTS : POINTS + 6]
        else:
            history[slot, t] = math.nan
