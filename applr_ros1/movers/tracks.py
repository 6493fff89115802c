"""Tracks: clusters followed from scan to scan, with the evidence that they move.

MoverTracker holds the tracks in an array. Each small cluster has a track with a constant-velocity
Kalman filter, whose covariance is the same along x and y (Bar-Shalom, Li and Kirubarajan,
"Estimation with Applications to Tracking and Navigation", 2001, section 6.2). A track is a moving
obstacle once its velocity differs clearly from zero and free space proves its motion
(free_space.py): an earlier scan saw through its position, or the current scan sees through its
previous position.
"""

import math
from typing import Any, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Array, Array32, Ints
from applr_ros1.common.kernels import kernel
from applr_ros1.movers.clusters import POINTS, Cluster, Clusters, centre
from applr_ros1.movers.free_space import LARGEST_FLOAT32, Fan, ends_at, sees_through
from applr_ros1.movers.slip import VOTER, VOTES, shift, slip

MAX_TRACKS = 192  # largest number of tracks

# id: identifier, 0 for an empty row. x, y: centre [m]. vx, vy: velocity [m/s].
# pp, pv, vv: variance of the position, covariance of position and velocity, variance of the
#     velocity, along each axis. radius [m].
# seen, evident: stamps of the last cluster and of the last evidence of motion [s].
# evidence, proofs: duration [s] of the evidence, and number of its proofs_of_motion().
# gone: number of scans that saw through the track. hits: number of clusters.
# mean_x, mean_y: moving average of the centre [m]. moves: whether the track is a moving obstacle.
# certain: whether it is one whose velocity is, or was, certain.
TRACK = np.dtype(
    [
        ("id", np.int64),
        ("x", np.float64),
        ("y", np.float64),
        ("vx", np.float64),
        ("vy", np.float64),
        ("pp", np.float64),
        ("pv", np.float64),
        ("vv", np.float64),
        ("radius", np.float64),
        ("seen", np.float64),
        ("evident", np.float64),
        ("evidence", np.float64),
        ("proofs", np.int64),
        ("gone", np.int64),
        ("hits", np.int64),
        ("mean_x", np.float64),
        ("mean_y", np.float64),
        ("moves", np.bool_),
        ("certain", np.bool_),
    ],
    align=True,
)
Track = Any  # a record of TRACK, which numba knows by its dtype
Tracks = Any  # an array (n,) of them

ACCELERATION = 0.2  # spectral density of the acceleration [m^2/s^3]
BEARING_RAD = 0.005  # standard deviation of a bearing in the odometry's frame [rad]
# Largest offset between the stamps of scan and pose [s]. It shifts bearings when the turn rate
# changes.
LATENCY_S = 0.04
# Turn of the robot during a scan above which the scan gives no evidence of motion [rad].
BENT_RAD = 0.15
# What a scan shows of a cluster's points, of which it must show so many alike
UNSEEN = 0
TAKEN = 1
FREE = 2
FEWEST_POINTS = 2
# Standard deviations of the position and the velocity of a new track.
FIRST_M = 0.1
FIRST_SPEED_M_S = 1.5
GATE = 9.0  # association gate: largest squared normalised distance of a cluster from a track
SUDDEN_M_S = 1.0  # change of velocity from scan to scan that the gate allows [m/s]
FARTHEST_M = 1.0  # largest distance of a cluster from its track along x and y [m]
# Difference of the radii of cluster and track that counts as one standard deviation [m].
RESIZED_M = 0.15
RADIUS_GAIN = 0.2  # share of a new radius in the filtered radius
# Speed above which a track may be a moving obstacle [m/s].
SLOWEST_M_S = 0.25
# Number of standard deviations by which a velocity must differ from zero.
CLEAR_DEVIATIONS = 2.0
# Evidence that makes a track a moving obstacle: duration, and number of proofs. One wrong beam is a
# proof in each scan, but what moves is proved by most of the earlier scans at once.
ENOUGH_S = 0.14
ENOUGH_PROOFS = 3
# Largest difference between a track's and its cluster's radii, to correct the laser's pose [m].
SAME_SIZE_M = 0.03
# Smallest number of scans in which a static track had a cluster, before it corrects the laser's
# pose.
SETTLED_HITS = 3
AVERAGED_S = 0.5  # averaging time of the position of a static track [s]
LARGEST_SHARE = 0.5  # largest share of one position in this average
SLIDES_M_S = 0.2  # largest lateral slip of a base that turns or brakes [m/s]
# Largest standard deviation of a velocity that is certain [m/s]. Moving obstacles in full view have
# 0.16 to 0.26 m/s. Static clusters that are seen in parts, and seem to move for a moment, have
# more.
CERTAIN_M_S = 0.28
SILENT_S = 1.0  # time without evidence after which a track is no longer a moving obstacle [s]
HIDDEN_S = 0.8  # time for which a hidden moving obstacle or leg is extrapolated [s]
LOST_S = 0.25  # time without a cluster after which any other track ends [s]
GONE_SCANS = 2  # number of scans that see through a track after which it ends
LEG_M = 0.12  # largest radius of a leg [m]
STEP_M = 0.7  # largest distance of the two legs of a person [m]


class EarlierScans(NamedTuple):
    """Earlier scans in FreeSpace: free depths (SCANS, n) [m], and FANs (SCANS,)."""

    ranges: Array32
    fans: Any


class Assignment(NamedTuple):
    """Assignment of clusters to tracks.

    cluster_of: (MAX_TRACKS,) index of each track's cluster, -1 if there is none. is_taken: (n,)
    whether each cluster has a track.
    """

    cluster_of: Ints
    is_taken: np.ndarray


@kernel
def predict(tracks: Tracks, interval: float) -> None:
    """Predict all tracks `interval` [s] ahead, with white noise as their acceleration."""
    for track in tracks:
        if track.id > 0:
            track.x += track.vx * interval
            track.y += track.vy * interval
            noise = ACCELERATION * interval * interval * interval / 3.0
            track.pp += interval * (2.0 * track.pv + interval * track.vv) + noise
            track.pv += interval * track.vv + 0.5 * ACCELERATION * interval * interval
            track.vv += ACCELERATION * interval


@kernel
def associate(tracks: Tracks, clusters: Clusters, fan: Fan, interval: float) -> Assignment:
    """Assign clusters to tracks, the nearest pairs first."""
    # Pairs of a track and a cluster that pass the gate.
    costs = np.empty(4 * MAX_TRACKS)
    pairs = np.empty((4 * MAX_TRACKS, 2), np.int64)
    pair_count = 0
    for track_index in range(tracks.shape[0]):
        track = tracks[track_index]
        if track.id == 0:
            continue
        for cluster_index in range(clusters.shape[0]):
            cluster = clusters[cluster_index]
            if abs(cluster.x - track.x) > FARTHEST_M or abs(cluster.y - track.y) > FARTHEST_M:
                continue
            cost = _cost(track, cluster, fan, interval)
            if cost < GATE and pair_count < costs.shape[0]:
                costs[pair_count] = cost
                pairs[pair_count] = track_index, cluster_index
                pair_count += 1

    cluster_of = np.full(MAX_TRACKS, -1)
    is_taken = np.zeros(clusters.shape[0], np.bool_)
    for pair in np.argsort(costs[:pair_count]):
        track_index = pairs[pair, 0]
        cluster_index = pairs[pair, 1]
        if cluster_of[track_index] < 0 and not is_taken[cluster_index]:
            cluster_of[track_index] = cluster_index
            is_taken[cluster_index] = True
    return Assignment(cluster_of, is_taken)


@kernel
def _cost(track: Track, cluster: Cluster, fan: Fan, interval: float) -> float:
    """Return the squared normalised distance of a cluster from a track, in position and size."""
    x, y, sigma = centre(cluster, track.radius, fan)
    offset_x = x - track.x
    offset_y = y - track.y
    variance = track.pp + sigma * sigma + (SUDDEN_M_S * interval) ** 2
    cost: float = (offset_x * offset_x + offset_y * offset_y) / variance
    # A cluster may be smaller than its disc if an edge is occluded, but never larger.
    growth = cluster.radius - track.radius
    if growth > 0.0 or _is_whole(cluster):
        cost += (growth / RESIZED_M) ** 2
    return cost


@kernel
def _is_whole(cluster: Cluster) -> bool:
    """Return whether both edges of a cluster are visible."""
    return not (cluster.start_hidden or cluster.end_hidden)


@kernel
def correct(track: Track, cluster: Cluster, fan: Fan, interval: float) -> None:
    """Update a track with the position and size of its cluster.

    interval: time since the last update [s].
    """
    if _is_whole(cluster):
        track.radius += RADIUS_GAIN * (cluster.radius - track.radius)
    else:
        track.radius = max(track.radius, cluster.radius)
    x, y, sigma = centre(cluster, track.radius, fan)

    # A mean of all positions at first, then of about the last AVERAGED_S.
    track.hits += 1
    share = max(1.0 / (track.hits + 1.0), min(interval / AVERAGED_S, LARGEST_SHARE))
    track.mean_x += share * (x - track.mean_x)
    track.mean_y += share * (y - track.mean_y)

    # Kalman filter.
    lever = BEARING_RAD * math.hypot(x - fan.x, y - fan.y)
    variance = track.pp + sigma * sigma + lever * lever
    gain = track.pp / variance
    velocity_gain = track.pv / variance
    offset_x = x - track.x
    offset_y = y - track.y
    track.x += gain * offset_x
    track.y += gain * offset_y
    track.vx += velocity_gain * offset_x
    track.vy += velocity_gain * offset_y
    track.vv -= velocity_gain * track.pv
    track.pv *= 1.0 - gain
    track.pp *= 1.0 - gain


@kernel
def proofs_of_motion(
    points: Array, history: Array, earlier: EarlierScans, depth: Array32, fan: Fan
) -> int:
    """Return how many earlier scans prove by their free space that a cluster has moved.

    An earlier scan then saw through its points, or the latest scan sees through their old
    positions.

    Args:
        points: (POINTS, 2) points of the cluster [m].
        history: (SCANS, POINTS, 2) positions of the points in the earlier scans [m]; NaN if the
            track had no cluster.
        earlier: earlier scans.
        depth: (n,) free depth of the latest scan's beams [m].
        fan: FAN of the latest scan.
    """
    proofs = 0
    for number in np.argsort(earlier.fans["stamp"]):
        old_fan = earlier.fans[number]
        swept_angle = max(fan.swept, old_fan.swept)
        if old_fan.stamp == -math.inf or swept_angle > BENT_RAD:
            continue
        bearing_error = LATENCY_S * abs(fan.turn_rate - old_fan.turn_rate) + swept_angle
        came = _view(earlier.ranges[number], old_fan, points, bearing_error)
        left = _view(depth, fan, history[number], bearing_error)
        view = max(came, left)
        # Something that the oldest of the scans shows at its place stands there.
        if view == TAKEN and proofs == 0:
            return 0
        proofs += view == FREE
    return proofs


@kernel
def _view(depth: Array32, fan: Fan, points: Array, bearing_error: float) -> int:
    """Return whether most of a cluster's points (POINTS, 2) [m] are FREE, TAKEN or UNSEEN."""
    free = 0
    taken = 0
    for index in range(POINTS):
        x = points[index, 0]
        y = points[index, 1]
        if not math.isnan(x):
            free += sees_through(depth, fan, x, y, bearing_error)
            taken += ends_at(depth, fan, x, y)
    if free >= FEWEST_POINTS:
        return FREE
    return TAKEN if taken >= FEWEST_POINTS else UNSEEN


@kernel
def follow(
    tracks: Tracks,
    history: Array,
    clusters: Clusters,
    depth: Array32,
    fans: Any,
    earlier: EarlierScans,
    interval: float,
    speed: float,
) -> Assignment:
    """Correct the laser's pose in `clusters` and `fans` in place, and update all tracks.

    Args:
        tracks: (MAX_TRACKS,) TRACKs.
        history: (SCANS, MAX_TRACKS, POINTS, 2) points of each track's cluster in the earlier scans
            [m].
        clusters: (n,) CLUSTERs of the scan.
        depth: (beams,) free depth of the scan's beams [m].
        fans: (1,) FAN of the scan.
        earlier: earlier scans.
        interval: time since the last scan [s].
        speed: speed of the laser according to the odometry [m/s].
    """
    fan = fans[0]
    predict(tracks, interval)
    assignment = associate(tracks, clusters, fan, interval)
    cluster_of = assignment.cluster_of
    _correct_pose(tracks, clusters, cluster_of, fan)
    for track_index in range(tracks.shape[0]):
        if cluster_of[track_index] >= 0:
            correct(tracks[track_index], clusters[cluster_of[track_index]], fan, interval)

    drift_x, drift_y = _drift(tracks, cluster_of, speed)
    for track_index in range(tracks.shape[0]):
        track = tracks[track_index]
        if track.id == 0:
            continue
        if cluster_of[track_index] < 0:
            # Dark clothes return nothing in some scans: only returns from behind show that it is
            # gone. Depths are float32.
            longest = np.float32(min(fan.range_max, LARGEST_FLOAT32))
            track.gone += sees_through(depth, fan, track.x, track.y, 0.0, longest)
            # One leg hides the other one; the visible part of a wall changes.
            longest_time = HIDDEN_S if track.moves or track.radius < LEG_M else LOST_S
            if track.gone >= GONE_SCANS or fan.stamp - track.seen > longest_time:
                track.id = 0
                track.moves = False
                history[:, track_index] = math.nan
            continue
        track.seen = fan.stamp
        track.gone = 0
        cluster = clusters[cluster_of[track_index]]
        # A wall seems to move while its visible part grows.
        is_same_size = abs(cluster.radius - track.radius) < RESIZED_M
        if is_same_size and _is_clearly_moving(track, drift_x, drift_y):
            old_points = history[:, track_index]
            proofs = proofs_of_motion(cluster.points, old_points, earlier, depth, fan)
            _weigh_evidence(track, proofs, fan.stamp, interval)
        if fan.stamp - track.evident > SILENT_S:
            _become_static(track)
        track.certain |= track.moves and track.vv <= CERTAIN_M_S**2
    return assignment


@kernel
def _become_static(track: Track) -> None:
    track.moves = False
    track.certain = False
    track.evidence = 0.0
    track.proofs = 0


@kernel
def _is_clearly_moving(track: Track, drift_x: float, drift_y: float) -> bool:
    """Return whether a track's velocity differs from zero and from the drift of static tracks."""
    clear_speed = max(SLOWEST_M_S, CLEAR_DEVIATIONS * math.sqrt(track.vv))
    if math.hypot(track.vx, track.vy) <= clear_speed:
        return False
    return math.hypot(track.vx - drift_x, track.vy - drift_y) > clear_speed


@kernel
def _weigh_evidence(track: Track, proofs: int, stamp: float, interval: float) -> None:
    """Count one more scan of a fast track, with the number of earlier scans that prove motion."""
    if proofs == 0:
        track.evidence = max(track.evidence - interval, 0.0)
        return
    track.evidence += interval
    track.proofs += proofs
    track.evident = stamp
    if track.evidence >= ENOUGH_S and track.proofs >= ENOUGH_PROOFS:
        track.moves = True


@kernel
def _correct_pose(tracks: Tracks, clusters: Clusters, cluster_of: Ints, fan: Fan) -> None:
    """Fit the scan to the static tracks that are settled, and whose clusters are whole."""
    voters = np.empty(MAX_TRACKS, VOTER)
    votes = 0
    for track_index in range(tracks.shape[0]):
        track = tracks[track_index]
        if cluster_of[track_index] < 0 or track.moves or track.hits < SETTLED_HITS:
            continue
        if math.hypot(track.vx, track.vy) > SLOWEST_M_S:
            continue
        cluster = clusters[cluster_of[track_index]]
        if _is_whole(cluster) and abs(cluster.radius - track.radius) < SAME_SIZE_M:
            voter = voters[votes]
            voter.x = track.mean_x
            voter.y = track.mean_y
            voter.variance = track.pp
            voter.cluster = cluster_of[track_index]
            votes += 1
    shift(clusters, fan, slip(voters[:votes], clusters, fan))


@kernel
def _drift(tracks: Tracks, cluster_of: Ints, speed: float) -> Tuple[float, float]:
    """Return the median velocity (x, y) [m/s] of the static tracks.

    It is zero if slip cannot explain it.
    """
    is_seen = (cluster_of >= 0) & (tracks["hits"] >= SETTLED_HITS)
    static_tracks = tracks[is_seen & ~tracks["moves"]]
    if len(static_tracks) < VOTES:
        return 0.0, 0.0
    drift_x = np.median(static_tracks["vx"])
    drift_y = np.median(static_tracks["vy"])
    if math.hypot(drift_x, drift_y) < speed + SLIDES_M_S:
        return drift_x, drift_y
    return 0.0, 0.0


@kernel
def begin(
    tracks: Tracks, clusters: Clusters, is_taken: np.ndarray, stamp: float, next_id: int
) -> int:
    """Start a track for each unassigned cluster, and return the next free ID.

    A cluster that overlaps a moving obstacle is a part of it, and gets no track.
    """
    free_rows = np.flatnonzero(tracks["id"] == 0)
    for cluster_index in np.flatnonzero(~is_taken):
        if len(free_rows) == 0:
            break
        cluster = clusters[cluster_index]
        if not _is_part_of_mover(cluster, tracks):
            _start(tracks[free_rows[0]], cluster, stamp, next_id)
            free_rows = free_rows[1:]
            next_id += 1
    return next_id


@kernel
def _is_part_of_mover(cluster: Cluster, tracks: Tracks) -> bool:
    for track in tracks:
        distance = math.hypot(track.x - cluster.x, track.y - cluster.y)
        if track.moves and distance < track.radius + cluster.radius:
            return True
    return False


@kernel
def _start(track: Track, cluster: Cluster, stamp: float, number: int) -> None:
    """Fill the row of a new track from its first cluster."""
    _become_static(track)
    track.id = number
    track.x = cluster.x
    track.y = cluster.y
    track.vx = 0.0
    track.vy = 0.0
    track.pp = FIRST_M**2
    track.pv = 0.0
    track.vv = FIRST_SPEED_M_S**2
    track.radius = cluster.radius
    track.seen = stamp
    track.evident = stamp
    track.gone = 0
    track.hits = 0
    track.mean_x = cluster.x
    track.mean_y = cluster.y


@kernel
def join_legs(discs: Array) -> None:
    """Join the legs of each person in place. A leg that is joined to another one gets radius inf.

    One leg stands while the other one swings at twice the speed of the person: their mean moves
    as the person does. What has not moved itself for SILENT_S, such as a post, is no leg.

    Args:
        discs: (n, k) moving obstacles, with x and y [m] first, and the radius [m] last.
    """
    for leg_index in range(discs.shape[0]):
        leg = discs[leg_index]
        for other in discs[leg_index + 1 :]:
            distance = math.hypot(other[0] - leg[0], other[1] - leg[1])
            if distance < STEP_M and max(leg[-1], other[-1]) < LEG_M:
                leg[:] = 0.5 * (leg + other)
                leg[-1] += 0.5 * distance
                other[-1] = np.inf


@kernel
def remember(history: Array, slot: int, cluster_of: Ints, clusters: Clusters) -> None:
    """Store the points of each track's cluster for the scan that FreeSpace keeps in row `slot`."""
    for track_index in range(cluster_of.shape[0]):
        if cluster_of[track_index] >= 0:
            history[slot, track_index] = clusters[cluster_of[track_index]].points
        else:
            history[slot, track_index] = math.nan
