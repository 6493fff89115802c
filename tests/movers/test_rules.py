"""Unit tests of the tracker's rules without a scene: free space, occluded edges, pose correction, tracks."""

import math

import numpy as np
import pytest

from applr_ros1.movers import clusters, tracks
from applr_ros1.movers.free_space import SCANS, STAMP, SWEPT, depths, sees_through
from applr_ros1.movers.slip import shift, slip

FAN = np.array(
    (0.0, 1.0, 2.0, 0.5, -1.0, 0.01, 0.1, 201.0, 0.0, 0.0)
)  # scan from (1, 2, 0.5), beam 100 ahead


@pytest.mark.parametrize(
    ("beams", "value", "through"),
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
def test_a_point_is_seen_through_if_the_beams_around_it_continue(beams, value, through):
    ranges = np.full(201, 4.0, np.float32)
    ranges[list(beams)] = value
    depth = depths(ranges, 0.1, 10.0)
    ahead = FAN[1] + 2.0 * math.cos(FAN[3]), FAN[2] + 2.0 * math.sin(FAN[3])
    assert sees_through(depth, FAN, *ahead, 0.0) == through
    assert not sees_through(depth, FAN, 2.0 * FAN[1] - ahead[0], 2.0 * FAN[2] - ahead[1], 0.0), (
        "behind the laser"
    )


@pytest.mark.parametrize(
    ("free", "swept", "moved"), [(1, 0.0, False), (2, 0.0, True), (3, 0.14, True), (3, 0.16, False)]
)
def test_two_of_three_points_prove_motion_in_undistorted_scans(free, swept, moved):
    """The points are in free space of the earlier scan, or were in that of the latest scan. A wall is 2 m away."""
    beams = np.array([50, 100, 150])
    angles = FAN[3] + FAN[4] + FAN[5] * beams
    points = np.column_stack([FAN[1] + 2.0 * np.cos(angles), FAN[2] + 2.0 * np.sin(angles)]).ravel()
    wall, through, fans = (
        np.full(201, 2.0, np.float32),
        np.full(201, 2.0, np.float32),
        np.zeros((SCANS, 10)),
    )
    for beam in beams[:free]:
        through[beam - 22 : beam + 23] = 4.0
    fans[:, STAMP], fans[0], newest = -np.inf, FAN, FAN.copy()
    newest[SWEPT] = swept
    history, ranges = np.full((SCANS, 6), np.nan), np.zeros((SCANS, 201), np.float32)
    ranges[0] = through
    assert tracks.has_moved(points, history, (ranges, fans), wall, newest) == moved
    history[0], ranges[0] = points, wall
    assert tracks.has_moved(points, history, (ranges, fans), through, newest) == moved


@pytest.mark.parametrize("step", [0.01, -0.01])
@pytest.mark.parametrize(
    "hidden",
    [(), (clusters.HIDDEN_FROM, clusters.FROM, -0.2), (clusters.HIDDEN_TO, clusters.TO, 0.2)],
    ids=["no edge hidden", "first edge hidden", "last edge hidden"],
)
def test_the_centre_of_a_disc_follows_from_its_visible_edge(hidden, step):
    """On one side of the disc, either a fifth of the edge is visible, or all of it."""
    sensor, radius, distance, bearing = (1.0, -1.0, 0.4), 0.3, 2.0, 0.7
    half, row = math.copysign(math.asin(radius / distance), step), np.zeros(clusters.COLUMNS)
    row[[clusters.NEAR, clusters.FROM, clusters.TO]] = (
        distance - radius,
        bearing - half,
        bearing + half,
    )
    if hidden:
        edge, end, seen = hidden
        row[edge], row[end] = 1.0, bearing + seen * half
    x, y, sigma = clusters.centre(row, radius, sensor)
    assert (x, y) == pytest.approx(
        (1.0 + 2.0 * math.cos(bearing), -1.0 + 2.0 * math.sin(bearing)), abs=1e-6
    )
    assert (sigma > 0.05) == bool(hidden)


def seen_from(sensor, by, places, outliers=0):
    """Return clusters (n, COLUMNS) of `places` (n, 2) for a laser at `sensor` with a pose error (dx, dy, turn)."""
    rows = np.zeros((len(places), clusters.COLUMNS))
    c, s = math.cos(by[2]), math.sin(by[2])
    x, y = (places - sensor[:2] - by[:2]).T
    rows[:, clusters.CX], rows[:, clusters.CY] = (
        sensor[0] + c * x + s * y,
        sensor[1] - s * x + c * y,
    )
    rows[:outliers, clusters.CX] += 0.8
    rows[:, clusters.SIGMA] = 0.02
    return rows


def test_static_tracks_correct_the_pose():
    """One of eight tracks is an outlier. If half of the tracks are, nothing is corrected."""
    sensor, by = np.array((5.0, -3.0, 0.6)), np.array((0.02, -0.03, 0.02))
    places = sensor[:2] + np.random.default_rng(0).uniform(-4.0, 4.0, (8, 2))
    given = np.column_stack([places, np.full(8, 1e-5)]), np.arange(8)
    rows = seen_from(sensor, by, places, outliers=1)
    correction = slip(*given, 8, rows, tuple(sensor))
    np.testing.assert_allclose(correction, by, atol=0.004)
    fan = FAN.copy()
    pose = shift(rows, fan, tuple(sensor), tuple(by))
    np.testing.assert_allclose(rows[1:, [clusters.CX, clusters.CY]], places[1:], atol=1e-9)
    np.testing.assert_allclose(rows[:, clusters.FROM], by[2])
    assert pose == tuple(fan[1:4]) == pytest.approx(sensor + by)
    assert slip(*given, 2, rows, tuple(sensor)) == (0.0, 0.0, 0.0), "two are too few"
    assert slip(*given, 8, seen_from(sensor, by, places, outliers=4), tuple(sensor)) == (
        0.0,
        0.0,
        0.0,
    )


@pytest.mark.parametrize(("moves", "begun"), [(1.0, [(4.0, 0.0)]), (0.0, [(2.2, 0.3), (4.0, 0.0)])])
def test_a_part_of_a_moving_obstacle_gets_no_track(moves, begun):
    known, rows = np.zeros((8, tracks.COLUMNS)), np.zeros((3, clusters.COLUMNS))
    known[0, [tracks.ID, tracks.TX, tracks.TR, tracks.MOVES]] = 5.0, 2.0, 0.3, moves
    rows[:, [clusters.CX, clusters.CY, clusters.RADIUS]] = (
        (2.2, 0.3, 0.1),
        (2.0, 0.0, 0.3),
        (4.0, 0.0, 0.3),
    )
    assert tracks.begin(known, rows, np.array([False, True, False]), 1.0, 7) == 7 + len(begun)
    new = known[known[:, tracks.ID] >= 7.0]
    assert [tuple(place) for place in new[:, [tracks.TX, tracks.TY]].tolist()] == begun


def test_a_track_is_predicted_with_constant_velocity_and_white_acceleration():
    """The state follows F = [[1, dt], [0, 1]], the covariance F P F' plus the integrated acceleration."""
    rows, dt, q = np.zeros((2, tracks.COLUMNS)), 0.3, tracks.ACCELERATION
    rows[0, [tracks.ID, tracks.TX, tracks.TY, tracks.VX, tracks.VY]] = 1.0, 2.0, -1.0, 0.5, -0.4
    rows[0, [tracks.PP, tracks.PV, tracks.VV]] = 0.02, 0.03, 0.5
    tracks.predict(rows, dt)
    step, before = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[0.02, 0.03], [0.03, 0.5]])
    after = step @ before @ step.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    assert rows[0, [tracks.PP, tracks.PV, tracks.VV]] == pytest.approx(
        [after[0, 0], after[0, 1], after[1, 1]]
    )
    assert rows[0, [tracks.TX, tracks.TY]] == pytest.approx([2.15, -1.12])
    assert not rows[1].any(), "an empty row"


def disc(x, radius=0.3, sigma=0.02):
    """Return the cluster of a fully visible disc on the x axis for a laser at the origin."""
    row, half = np.zeros(clusters.COLUMNS), math.asin(radius / x)
    row[[clusters.CX, clusters.RADIUS, clusters.NEAR, clusters.SIGMA]] = (
        x,
        radius,
        x - radius,
        sigma,
    )
    row[[clusters.FROM, clusters.TO]] = -half, half
    return row


@pytest.mark.parametrize(("deviations", "larger", "number"), [
    (2.95, 0.0, 0), (-2.95, 0.0, 0), (3.05, 0.0, -1), (-3.05, 0.0, -1), (2.0, 2.2, 0), (2.0, 2.3, -1),
])  # fmt: skip
def test_a_cluster_within_three_deviations_of_position_and_size_is_associated(
    deviations, larger, number
):
    rows, dt = np.zeros((tracks.MAX_TRACKS, tracks.COLUMNS)), 0.05
    rows[0, [tracks.ID, tracks.TX, tracks.TR, tracks.PP]] = 1.0, 3.0, 0.3, 0.1**2
    deviation = math.sqrt(0.1**2 + 0.02**2 + (tracks.SUDDEN_M_S * dt) ** 2)
    cluster = disc(3.0 + deviations * deviation)
    cluster[clusters.RADIUS] += larger * tracks.RESIZED_M
    numbers, taken = tracks.associate(rows, cluster[np.newaxis], (0.0, 0.0, 0.0), dt)
    assert (numbers[0], taken[0], numbers[1:].max()) == (number, number == 0, -1)


@pytest.mark.parametrize(
    ("hits", "dt", "share"), [(0, 0.05, 1 / 2), (3, 0.05, 1 / 5), (200, 0.05, 0.1), (200, 5.0, 0.5)]
)
def test_the_mean_position_of_a_static_track_averages_half_a_second(hits, dt, share):
    row = np.zeros(tracks.COLUMNS)
    row[[tracks.ID, tracks.TX, tracks.TR, tracks.PP, tracks.HITS]] = 1.0, 3.0, 0.3, 0.01, hits
    row[[tracks.MX, tracks.MY]] = 3.0, 1.0
    tracks.correct(row, disc(3.4), (0.0, 0.0, 0.0), dt)
    assert row[[tracks.MX, tracks.MY]] == pytest.approx([3.0 + 0.4 * share, 1.0 - share])
