"""Unit tests of the tracker's rules without a scene."""

import math

import numpy as np
import pytest

from applr_ros1.common.scan import beam_directions, distances_of
from applr_ros1.movers import clusters, tracks
from applr_ros1.movers.clusters import CLUSTER, MAX_CLUSTERS, POINTS
from applr_ros1.movers.free_space import FAN, SCANS, depths, sees_through
from applr_ros1.movers.slip import VOTER, Correction, shift, slip
from applr_ros1.movers.tracks import MAX_TRACKS, TRACK


def record(dtype, **fields):
    """Return a record of a structured dtype; fields that are not given are 0."""
    row = np.zeros(1, dtype)[0]
    for name, value in fields.items():
        row[name] = value
    return row


# Scan from (1, 2, 0.5), whose beam 100 points ahead.
SCAN = {
    "x": 1.0,
    "y": 2.0,
    "yaw": 0.5,
    "angle_min": -1.0,
    "increment": 0.01,
    "range_min": 0.1,
    "range_max": 10.0,
    "beams": 201,
}
AT_ORIGIN = record(FAN)


def no_scans():
    """Return the memory of scans before the first one."""
    fans = np.zeros(SCANS, FAN)
    fans["stamp"] = -np.inf
    return tracks.EarlierScans(np.zeros((SCANS, 201), np.float32), fans)


@pytest.mark.parametrize(
    ("beams", "value", "sees_it_through"),
    [
        ([], 0.0, True),
        ([100], 2.10, False),
        ([100], 2.15, True),  # range at least 12 cm behind the point
        ([95], 1.9, False),  # a beam up to 5 beams (0.02 rad, 6 cm) away ends too near
        ([105], 1.9, False),
        ([93], 1.9, True),
        (range(94, 99), np.nan, True),
        (range(94, 101), np.nan, False),  # more than half are invalid
        (range(94, 101), 0.05, False),
        (range(94, 101), -np.inf, False),
        (range(94, 107), np.inf, True),
    ],
)
def test_a_point_is_seen_through_if_the_beams_around_it_continue(beams, value, sees_it_through):
    fan = record(FAN, **SCAN)
    ranges = np.full(201, 4.0, np.float32)
    ranges[list(beams)] = value
    depth = depths(distances_of(ranges, 0.1, 10.0), range_max=10.0)
    offset_x = 2.0 * math.cos(fan["yaw"])
    offset_y = 2.0 * math.sin(fan["yaw"])

    ahead = sees_through(depth, fan, fan["x"] + offset_x, fan["y"] + offset_y, 0.0)
    behind = sees_through(depth, fan, fan["x"] - offset_x, fan["y"] - offset_y, 0.0)

    assert ahead == sees_it_through
    assert not behind


@pytest.mark.parametrize(
    ("free", "swept", "older", "proofs"),
    [
        (1, 0.0, [], 0),
        (2, 0.0, [], 1),
        (3, 0.14, [], 1),
        (3, 0.16, [], 0),  # over BENT_RAD [rad], a distorted scan proves nothing
        (3, 0.0, [4.0], 2),
        (3, 0.0, [2.0], 0),  # stood there before
    ],
)
def test_two_of_three_points_prove_motion_in_undistorted_scans(free, swept, older, proofs):
    """The points are in free space of the earlier scan, or were in that of the latest scan."""
    # Given: three points at 2 m, and a scan that sees through the place of the first `free` ones
    beams = np.array([50, 100, 150])
    angles = SCAN["yaw"] + SCAN["angle_min"] + SCAN["increment"] * beams
    x = SCAN["x"] + 2.0 * np.cos(angles)
    y = SCAN["y"] + 2.0 * np.sin(angles)
    points = np.column_stack([x, y])
    wall = np.full(201, 2.0, np.float32)
    ranges_through = wall.copy()
    for beam in beams[:free]:
        ranges_through[beam - 22 : beam + 23] = 4.0
    fan = record(FAN, swept=swept, **SCAN)
    earlier = no_scans()
    ranges, fans = earlier
    fans[0] = record(FAN, **SCAN)
    for ranges[1] in older:
        fans[1] = record(FAN, **{**SCAN, "stamp": -1.0})
    history = np.full((SCANS, POINTS, 2), np.nan)

    # When the earlier scan sees through
    ranges[0] = ranges_through
    assert tracks.proofs_of_motion(points, history, earlier, wall, fan) == proofs

    # When the latest scan sees through the points of the earlier one
    history[0] = points
    ranges[0] = wall
    assert tracks.proofs_of_motion(points, history, earlier, ranges_through, fan) == proofs


@pytest.mark.parametrize("increment", [0.01, -0.01])
@pytest.mark.parametrize("hidden", ["", "start", "end"])
def test_the_centre_of_a_disc_follows_from_its_visible_edge(hidden, increment):
    """On one side of the disc, either a fifth of the edge is visible, or all of it."""
    radius = 0.3
    distance = 2.0
    bearing = 0.7
    # The sign is that of the beams' order: `start` is the edge that is measured first.
    half_angle = math.copysign(math.asin(radius / distance), increment)
    fan = record(FAN, x=1.0, y=-1.0, yaw=0.4)
    cluster = record(
        CLUSTER,
        near=distance - radius,
        start=bearing - half_angle,
        end=bearing + half_angle,
    )
    if hidden == "start":
        cluster["start"] = bearing - 0.2 * half_angle
        cluster["start_hidden"] = True
    elif hidden == "end":
        cluster["end"] = bearing + 0.2 * half_angle
        cluster["end_hidden"] = True

    x, y, sigma = clusters.centre(cluster, radius, fan)

    assert x == pytest.approx(1.0 + distance * math.cos(bearing), abs=1e-6)
    assert y == pytest.approx(-1.0 + distance * math.sin(bearing), abs=1e-6)
    expected_sigma = cluster["sigma"]
    if hidden:
        # Six tenths of the half angle are seen on each side of the middle of what is seen.
        hidden_m = 0.4 * abs(half_angle) * distance
        expected_sigma += clusters.SIGMA_HIDDEN_M + clusters.SIGMA_HIDDEN_WIDTH * hidden_m
    assert sigma == pytest.approx(expected_sigma)


@pytest.mark.parametrize(
    ("distance", "beam_count", "count"),
    [
        # At 3 m, a chord with half a beam at each end of 1.57 m, or of 1.601 m
        (3.0, 53, 1),
        (3.0, 54, 0),
        # At 0.3 m, half of the angle is 1.295 rad, or 1.305 rad.
        (0.3, 259, 1),
        (0.3, 261, 0),
    ],
)
def test_a_cluster_wider_than_a_moving_obstacle_is_left_out(distance, beam_count, count):
    ranges = np.full(300, np.inf, np.float32)
    ranges[20 : 20 + beam_count] = distance
    fans = np.zeros(1, FAN)
    fans[0] = record(FAN, angle_min=-1.5, increment=0.01, range_min=0.1, range_max=10.0, beams=300)
    directions = beam_directions(-1.5, 0.01, 300)
    found = np.zeros(MAX_CLUSTERS, CLUSTER)
    assert clusters.find_clusters(ranges, directions, fans, found) == count


def seen_from(fan, error, places, outliers=0):
    """Return CLUSTERs (n,) of `places` (n, 2) for a laser with a pose error."""
    cos_turn = math.cos(error.turn)
    sin_turn = math.sin(error.turn)
    x = places[:, 0] - fan["x"] - error.dx
    y = places[:, 1] - fan["y"] - error.dy
    clusters_seen = np.zeros(len(places), CLUSTER)
    clusters_seen["x"] = fan["x"] + cos_turn * x + sin_turn * y
    clusters_seen["y"] = fan["y"] - sin_turn * x + cos_turn * y
    clusters_seen["x"][:outliers] += 0.8
    clusters_seen["sigma"] = 0.02
    return clusters_seen


def voters_at(places, variance):
    """Return VOTERs (n,) at `places` (n, 2), one for each cluster."""
    voters = np.zeros(len(places), VOTER)
    voters["x"], voters["y"] = places.T
    voters["variance"] = variance
    voters["cluster"] = np.arange(len(places))
    return voters


def test_static_tracks_correct_the_pose():
    """One of eight tracks is an outlier. If half of the tracks are, nothing is corrected."""
    # Given: eight static tracks around a laser whose pose is wrong by some centimetres
    fan = record(FAN, x=5.0, y=-3.0, yaw=0.6)
    error = Correction(dx=0.02, dy=-0.03, turn=0.02)
    no_correction = Correction(dx=0.0, dy=0.0, turn=0.0)
    rng = np.random.default_rng(0)
    places = (5.0, -3.0) + rng.uniform(-4.0, 4.0, (8, 2))
    x, y = places.T
    voters = voters_at(places, 1e-5)
    clusters_seen = seen_from(fan, error, places, outliers=1)
    half_outliers = seen_from(fan, error, places, outliers=4)

    # Then: the error follows from the tracks
    np.testing.assert_allclose(slip(voters, clusters_seen, fan), error, atol=0.004)
    assert slip(voters[:2], clusters_seen, fan) == no_correction, "two are too few"
    assert slip(voters, half_outliers, fan) == no_correction

    # When the laser's pose is corrected, the clusters lie on their tracks, except for the first
    # one, which is the outlier.
    shift(clusters_seen, fan, error)
    np.testing.assert_allclose(clusters_seen["x"][1:], x[1:], atol=1e-9)
    np.testing.assert_allclose(clusters_seen["y"][1:], y[1:], atol=1e-9)
    np.testing.assert_allclose(clusters_seen["start"], error.turn)
    assert fan["x"] == pytest.approx(5.02)
    assert fan["y"] == pytest.approx(-3.03)
    assert fan["yaw"] == pytest.approx(0.62)


def test_tracks_on_one_side_correct_the_pose():
    """A turn then shifts all of them to one side, as a shift does."""
    fan = record(FAN, x=5.0, y=-3.0, yaw=0.6)
    error = Correction(dx=0.02, dy=-0.03, turn=0.02)
    rng = np.random.default_rng(0)
    places = (8.0, -1.0) + rng.uniform(-1.0, 1.0, (8, 2))
    voters = voters_at(places, 1e-6)
    clusters_seen = seen_from(fan, error, places)
    clusters_seen["sigma"] = 0.001
    np.testing.assert_allclose(slip(voters, clusters_seen, fan), error, atol=0.002)


@pytest.mark.parametrize(
    ("track_fields", "cluster_fields", "corrects"),
    [
        ({}, {}, True),
        ({}, {"start_hidden": True}, False),
        ({}, {"end_hidden": True}, False),
        ({}, {"radius": 0.32}, True),
        ({}, {"radius": 0.34}, False),  # a merged cluster, whose centre is elsewhere
        ({}, {"radius": 0.26}, False),
        ({"hits": 3}, {}, True),
        ({"hits": 2}, {}, False),
        ({"vx": 0.24}, {}, True),
        ({"vx": 0.26}, {}, False),
        ({"moves": True}, {}, False),
    ],
)
def test_settled_tracks_with_whole_clusters_of_their_size_correct_the_pose(
    track_fields, cluster_fields, corrects
):
    # Given: six static tracks around a laser whose pose is 3 cm ahead
    fans = np.zeros(1, FAN)
    for name in ("angle_min", "increment", "range_min", "beams"):
        fans[name] = SCAN[name]
    places = np.array([(2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0), (2.0, -2.0)])
    clusters_seen = seen_from(fans[0], Correction(dx=0.03, dy=0.0, turn=0.0), places)
    clusters_seen["radius"] = 0.3
    distance = np.hypot(clusters_seen["x"], clusters_seen["y"])
    bearing = np.arctan2(clusters_seen["y"], clusters_seen["x"])
    half_angle = np.arcsin(0.3 / distance)
    clusters_seen["near"] = distance - 0.3
    clusters_seen["start"] = bearing - half_angle
    clusters_seen["end"] = bearing + half_angle
    known = np.zeros(MAX_TRACKS, TRACK)
    rows = known[: len(places)]
    rows["id"] = np.arange(1, len(places) + 1)
    rows["x"], rows["y"] = places.T
    rows["mean_x"], rows["mean_y"] = places.T
    rows["pp"] = 1e-5
    rows["radius"] = 0.3
    rows["hits"] = 10
    for name, value in track_fields.items():
        rows[name] = value
    for name, value in cluster_fields.items():
        clusters_seen[name] = value
    history = np.full((SCANS, MAX_TRACKS, POINTS, 2), np.nan)
    depth = np.full(201, 4.0, np.float32)

    # When
    tracks.follow(known, history, clusters_seen, depth, fans, no_scans(), 0.05, 0.0)

    # Then
    assert fans[0]["x"] == pytest.approx(0.03 if corrects else 0.0, abs=0.005)


# Positions of two clusters [m]: one overlaps a track at (2, 0), the other is far from it.
PART = (2.2, 0.3)
OTHER = (4.0, 0.0)


@pytest.mark.parametrize(
    ("moves", "begun_at"),
    [
        (True, [OTHER]),
        (False, [PART, OTHER]),
    ],
)
def test_a_part_of_a_moving_obstacle_gets_no_track(moves, begun_at):
    known = np.zeros(8, TRACK)
    known[0] = record(TRACK, id=5, x=2.0, radius=0.3, moves=moves)
    part_x, part_y = PART
    other_x, other_y = OTHER
    clusters_seen = np.zeros(3, CLUSTER)
    clusters_seen[0] = record(CLUSTER, x=part_x, y=part_y, radius=0.1)
    clusters_seen[1] = record(CLUSTER, x=2.0, y=0.0, radius=0.3)
    clusters_seen[2] = record(CLUSTER, x=other_x, y=other_y, radius=0.3)
    has_track = np.array([False, True, False])
    next_id = 7

    id_after = tracks.begin(known, clusters_seen, has_track, 1.0, next_id)

    new_tracks = known[known["id"] >= next_id]
    assert id_after == next_id + len(begun_at)
    assert list(zip(new_tracks["x"], new_tracks["y"])) == begun_at


def test_a_new_track_has_nothing_of_the_track_that_had_its_row():
    """Rows of ended tracks keep their values; what a new track needs is set."""
    old_row = np.zeros(1, TRACK)
    for field_name in TRACK.names:
        old_row[0][field_name] = 9
    old_row["id"] = 0
    old_row["moves"] = False
    clusters_seen = np.zeros(1, CLUSTER)
    clusters_seen[0] = record(CLUSTER, x=2.0, y=1.0, radius=0.3)
    empty_row = np.zeros(1, TRACK)

    tracks.begin(old_row, clusters_seen, np.array([False]), 1.0, 7)
    tracks.begin(empty_row, clusters_seen, np.array([False]), 1.0, 7)

    assert old_row[0] == empty_row[0]


def test_a_track_is_predicted_with_constant_velocity_and_white_acceleration():
    """The state follows F = [[1, dt], [0, 1]], the covariance F P F' plus the acceleration's."""
    track_rows = np.zeros(2, TRACK)
    track_rows[0] = record(
        TRACK,
        id=1,
        x=2.0,
        y=-1.0,
        vx=0.5,
        vy=-0.4,
        pp=0.02,
        pv=0.03,
        vv=0.5,
    )
    dt = 0.3

    tracks.predict(track_rows, dt)

    transition = np.array(
        [
            [1.0, dt],
            [0.0, 1.0],
        ]
    )
    covariance = np.array(
        [
            [0.02, 0.03],
            [0.03, 0.5],
        ]
    )
    # Covariance of position and speed after white acceleration of spectral density 1
    noise_covariance = np.array(
        [
            [dt**3 / 3, dt**2 / 2],
            [dt**2 / 2, dt],
        ]
    )
    noise = tracks.ACCELERATION * noise_covariance
    predicted_covariance = transition @ covariance @ transition.T + noise
    track = track_rows[0]
    assert track["pp"] == pytest.approx(predicted_covariance[0, 0])
    assert track["pv"] == pytest.approx(predicted_covariance[0, 1])
    assert track["vv"] == pytest.approx(predicted_covariance[1, 1])
    assert track["x"] == pytest.approx(2.15)
    assert track["y"] == pytest.approx(-1.12)
    assert track_rows[1] == record(TRACK), "an empty row"


def disc(x, radius=0.3, sigma=0.02):
    """Return the CLUSTER of a fully visible disc on the x axis for a laser at the origin."""
    half_angle = math.asin(radius / x)
    return record(
        CLUSTER,
        x=x,
        radius=radius,
        near=x - radius,
        sigma=sigma,
        start=-half_angle,
        end=half_angle,
    )


@pytest.mark.parametrize(
    ("deviations", "larger", "number"),
    [
        (2.95, 0.0, 0),
        (-2.95, 0.0, 0),
        (3.05, 0.0, -1),
        (-3.05, 0.0, -1),
        (2.0, 2.2, 0),
        (2.0, 2.3, -1),
    ],
)
def test_a_cluster_within_three_deviations_of_position_and_size_is_associated(
    deviations, larger, number
):
    interval = 0.05
    track_rows = np.zeros(MAX_TRACKS, TRACK)
    track_rows[0] = record(TRACK, id=1, x=3.0, radius=0.3, pp=0.1**2)
    # Three causes of a deviation: the track, the cluster, and a sudden motion since the last scan
    sudden_motion = tracks.SUDDEN_M_S * interval
    variance = 0.1**2 + 0.02**2 + sudden_motion**2
    deviation = math.sqrt(variance)
    clusters_seen = np.zeros(1, CLUSTER)
    clusters_seen[0] = disc(3.0 + deviations * deviation)
    clusters_seen["radius"] += larger * tracks.RESIZED_M

    cluster_of, is_taken = tracks.associate(track_rows, clusters_seen, AT_ORIGIN, interval)

    assert cluster_of[0] == number
    assert is_taken[0] == (number == 0)
    assert cluster_of[1:].max() == -1


@pytest.mark.parametrize(
    ("hits", "interval", "share"),
    [
        # The first hits are averaged with equal weights.
        (0, 0.05, 1 / 2),
        (3, 0.05, 1 / 5),
        # Later ones count as much as their share of half a second, but at most half.
        (200, 0.05, 0.1),
        (200, 5.0, 0.5),
    ],
)
def test_the_mean_position_of_a_static_track_averages_half_a_second(hits, interval, share):
    track = record(
        TRACK,
        id=1,
        x=3.0,
        radius=0.3,
        pp=0.01,
        hits=hits,
        mean_x=3.0,
        mean_y=1.0,
    )

    # The cluster is 0.4 m and 1 m from the mean.
    tracks.correct(track, disc(3.4), AT_ORIGIN, interval)

    assert track["mean_x"] == pytest.approx(3.0 + 0.4 * share)
    assert track["mean_y"] == pytest.approx(1.0 - share)


@pytest.mark.filterwarnings("error")
def test_a_range_max_that_no_float32_holds_is_no_limit():
    distances = distances_of([0.05, 2.0, np.inf, np.nan], 0.1, 1e300)
    longest = np.finfo(np.float32).max
    assert depths(distances, 1e300).tolist() == [0.0, 2.0, longest, 0.0]
