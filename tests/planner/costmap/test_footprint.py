"""Tests of the footprint (parsing, padding, radii) and of the line of cells between two cells."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.grid import walk_line
from tests.support.refusals import refused
from tests.support.seeds import examples

OUTLINE = "[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"
coordinate = st.floats(-0.6, 0.6).map(lambda v: round(v, 3))
polygons = st.lists(st.tuples(coordinate, coordinate), min_size=0, max_size=7).map(
    lambda points: np.array(points, dtype=np.float64).reshape(-1, 2)
)


def test_the_padded_footprint_of_the_jackal_has_its_known_radii():
    padded = footprints.pad(footprints.parse(OUTLINE), 0.1)
    assert footprints.radii(padded) == (pytest.approx(0.265), pytest.approx(0.408, abs=1e-3))
    np.testing.assert_allclose(padded.max(axis=0) - padded.min(axis=0), (0.62, 0.53))
    np.testing.assert_array_equal(
        footprints.pad([[0.0, 0.2], [-0.1, 0.0]], 0.05), [[0.0, 0.25], [-0.1 - 0.05, 0.0]]
    )


def test_parse_reads_values_as_the_cpp_node_does():
    assert footprints.parse("[[12.34567, 1], [2, 3], [4, 5]]")[0, 0] == float(np.float32(12.3457))
    assert footprints.parse([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])[2, 1] == float(np.float32(0.6))
    assert footprints.parse("[[1 2] [3,-.5],\t[5e-1, 6]]").tolist() == [
        [1.0, 2.0],
        [3.0, -0.5],
        [0.5, 6.0],
    ]
    assert footprints.parse("[]").shape == footprints.parse("").shape == (0, 2)


@pytest.mark.parametrize(
    "text", ["[[0,0],[1,1]]", "[[0,0],[1,1],[2]]", "__import__('os')", "[[0,0],[1,1],[2,1e999]]"]
)
def test_parse_rejects_in_one_line(text):
    refused(lambda: footprints.parse(text), "footprint")


def test_radii_of_few_points_and_of_a_zero_length_edge():
    huge = np.finfo(np.float64).max
    assert (
        footprints.radii(np.zeros((0, 2)))
        == footprints.radii([[1.0, 1.0], [2.0, 2.0]])
        == (huge, 0.0)
    )
    square = [[1, 1], [1, 1], [-1, 1], [-1, -1], [1, -1]]
    assert footprints.radii(square) == (1.0, math.sqrt(2))
    assert len(footprints.circle(0.46)) == 16
    assert footprints.radii(footprints.circle(0.46))[1] == pytest.approx(0.46)


@given(polygons, st.floats(-3, 3), st.floats(-2, 2), st.floats(-7, 7))
@examples(100)
def test_transform_keeps_distances(vertices, x, y, yaw):
    placed = footprints.transform(vertices, x, y, yaw)
    np.testing.assert_allclose(np.hypot(*(placed - (x, y)).T), np.hypot(*vertices.T), atol=1e-12)


@given(*[st.integers(0, 30)] * 4)
@examples(200)
def test_line_is_connected_and_has_one_cell_per_major_step(x0, y0, x1, y1):
    xs, ys = np.empty((2, 31), np.int64)
    count = walk_line(x0, y0, x1, y1, xs, ys)
    line = np.stack((xs, ys), axis=1)[:count]
    assert (tuple(line[0]), tuple(line[-1])) == ((x0, y0), (x1, y1))
    assert len(line) == max(abs(x1 - x0), abs(y1 - y0)) + 1
    assert (np.abs(np.diff(line, axis=0)).max(axis=1) == 1).all()
