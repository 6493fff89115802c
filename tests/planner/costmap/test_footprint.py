"""Tests of the footprint (parsing, padding, radii) and of the line of cells between two cells."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.planner.costmap import footprint as footprints
from tests.support.refusals import refused
from tests.support.seeds import examples

OUTLINE = "[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"
COORDINATES = st.floats(-0.6, 0.6).map(lambda coordinate: round(coordinate, 3))
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES), min_size=0, max_size=7)
POLYGONS = POINTS.map(lambda points: np.array(points, dtype=np.float64).reshape(-1, 2))


def test_the_padded_footprint_of_the_jackal_has_its_known_radii():
    padded = footprints.pad(footprints.parse(OUTLINE), 0.1)
    inscribed, circumscribed = footprints.radii(padded)
    assert inscribed == pytest.approx(0.265)
    assert circumscribed == pytest.approx(0.408, abs=1e-3)
    np.testing.assert_allclose(np.ptp(padded, axis=0), (0.62, 0.53))


def test_padding_moves_coordinates_away_from_0_and_leaves_0_alone():
    padded = footprints.pad([[0.0, 0.2], [-0.1, 0.0]], 0.05)
    expected = [[0.0, 0.25], [-0.1 - 0.05, 0.0]]
    np.testing.assert_array_equal(padded, expected)


def test_parse_reads_values_as_the_cpp_node_does():
    # Six digits of a text, and float32 of both
    of_text = footprints.parse("[[12.34567, 1], [2, 3], [4, 5]]")
    assert of_text[0, 0] == float(np.float32(12.3457))
    of_list = footprints.parse([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    assert of_list[2, 1] == float(np.float32(0.6))
    # Commas may be missing, and numbers short.
    loosely_written = footprints.parse("[[1 2] [3,-.5],\t[5e-1, 6]]")
    assert loosely_written.tolist() == [
        [1.0, 2.0],
        [3.0, -0.5],
        [0.5, 6.0],
    ]
    assert footprints.parse("[]").shape == (0, 2)
    assert footprints.parse("").shape == (0, 2)


@pytest.mark.parametrize(
    "text",
    [
        "[[0,0],[1,1]]",
        "[[0,0],[1,1],[2]]",
        "__import__('os')",
        "[[0,0],[1,1],[2,1e999]]",
    ],
)
def test_parse_rejects_in_one_line(text):
    refused(lambda: footprints.parse(text), "footprint")


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 2)),
        [[1.0, 1.0], [2.0, 2.0]],
    ],
)
def test_fewer_than_three_points_have_no_inside(points):
    huge = np.finfo(np.float64).max
    assert footprints.radii(points) == (huge, 0.0)


def test_an_edge_without_length_does_not_count():
    square = [[1, 1], [1, 1], [-1, 1], [-1, -1], [1, -1]]
    assert footprints.radii(square) == (1.0, math.sqrt(2))


SQUARE = [(0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2)]
# A fork, whose prongs end on one line
FORK = [(0.3, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2), (0.3, -0.1), (0, 0), (0.3, 0.1)]


@pytest.mark.parametrize(
    ("outline", "crosses"),
    [
        (SQUARE, False),
        ([*SQUARE, SQUARE[0]], False),
        (FORK, False),
        ([], False),
        ([SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]], True),
        ([*FORK[:5], (-0.4, 0), FORK[6]], True),
    ],
    ids=["square", "first corner repeated", "fork", "none", "hourglass", "one corner too far"],
)
def test_an_outline_whose_corners_are_out_of_order_crosses_itself(outline, crosses):
    vertices = footprints.parse(outline)
    # Neither the direction, nor the first corner, nor the heading matters.
    for order in (vertices, vertices[::-1], np.roll(vertices, 2, axis=0)):
        for yaw in (0.0, 0.7):
            assert footprints.crosses_itself(footprints.transform(order, 0.0, 0.0, yaw)) == crosses


def test_a_circle_has_sixteen_vertices_at_its_radius():
    circle = footprints.circle(0.46)
    _, circumscribed = footprints.radii(circle)
    assert len(circle) == 16
    assert circumscribed == pytest.approx(0.46)


@given(POLYGONS, st.floats(-3, 3), st.floats(-2, 2), st.floats(-7, 7))
@examples(100)
def test_transform_keeps_distances(vertices, x, y, yaw):
    placed = footprints.transform(vertices, x, y, yaw)
    distances = np.linalg.norm(placed - (x, y), axis=1)
    expected = np.linalg.norm(vertices, axis=1)
    np.testing.assert_allclose(distances, expected, atol=1e-12)
