"""Tests of moving obstacles: DynaBARN's table of key frames, positions over time, and speeds in
generated rooms.
"""

import math

import numpy as np
import pytest

import worlds
from applr_ros1.common.paths import step_lengths
from tests.support.refusals import refused
from tests.support.scenes import moving, refused_world, sdf, small_world, write_world
from worlds import dynabarn


def table(folder, *rows):
    """Write the table of key frames with some rows, and return its path."""
    table_file = folder / dynabarn.NAME
    head = ",".join(dynabarn.COLUMNS)
    table_file.write_text("\n".join([head, *rows]) + "\n")
    return table_file


def world_of(folder, name, *contents, **options):
    """Write a world file with the contents of sdf(), and return its world."""
    return worlds.load(write_world(folder, sdf(*contents), name, **options))


def test_positions_over_time_equal_gazebos(tmp_path):
    """Catmull-Rom tangents with tension 0 between key frames, computed by hand. The animation
    repeats every 10 s.
    """
    # Given: key frames time, x, y in a table with the byte order mark and line ends of Windows
    table_file = table(
        tmp_path,
        "hardlibobs_7,10,1,0,0,0",
        "hardlibobs_7,10,1,2,4,0",
        "hardlibobs_7,10,1,4,4,4",
        "hardlibobs_7,10,1,8,0,8",
    )
    rows = table_file.read_bytes().replace(b"\n", b"\r\n")
    table_file.write_bytes(b"\xef\xbb\xbf" + rows)
    world = world_of(tmp_path, "world_0.world", moving("hardlibobs_7"))
    (mover,) = world.movers

    # At a key frame, the obstacle is there.
    assert mover.position(0.0) == (0.0, 0.0)
    assert mover.position(2.0) == (4.0, 0.0)
    # Halfway: mean of the ends + 1/8 of the difference of their tangents, (2, 0) at the first and
    # (2, 2) at the next
    first_middle = (2.0, 0.0 + (0.0 - 2.0) / 8)
    second_middle = (4.0 + (2.0 - -2.0) / 8, 2.0 + (2.0 - 4.0) / 8)
    third_middle = (2.0, 6.0 + (4.0 - 2.0) / 8)
    assert mover.position(1.0) == pytest.approx(first_middle)
    assert mover.position(3.0) == pytest.approx(second_middle)
    assert mover.position(6.0) == pytest.approx(third_middle)
    # It stands after its last key frame, and begins again.
    assert mover.position(9.0) == (0.0, 8.0)
    assert mover.position(13.0) == pytest.approx(mover.position(3.0))


@pytest.mark.parametrize("row", ["a,nan,1,0,0,0", "a,1,1,0,inf,0", "a,1,1,zero,0,0"])
def test_a_row_with_anything_but_finite_numbers_is_refused(row, tmp_path):
    table_file = table(tmp_path, row)
    refused(lambda: dynabarn.read_table(str(table_file)), f"{table_file}: a row of a is '.*: give")


def test_a_plugin_without_rows_in_the_table_is_refused(tmp_path):
    table(tmp_path, "hardlibobs_7,10,1,0,0,0")
    models = moving("hardlibobs_7") + moving("lamp")
    world = write_world(tmp_path, sdf(models), "world_1.world")
    refused_world(world, "'lamp' has the Gazebo plugin '.*lamp.so', which has no rows in")


def test_a_closed_path_has_no_corner_where_it_closes():
    # Time, x, y
    key_frames = (
        (0.0, 0.0, 0.0),
        (1.0, 2.0, 0.0),
        (2.0, 2.0, 2.0),
        (3.0, 0.0, 0.0),
    )
    mover = worlds.Mover(0.5, key_frames)
    # The tangent at the first point is half the chord from the last point but one to the second
    # point.
    first_middle = (1.0 + (0.0 - 1.0) / 8, 0.0 + (-1.0 - 1.0) / 8)
    assert mover.position(0.5) == pytest.approx(first_middle)


def test_two_key_frames_at_one_time_are_a_jump():
    key_frames = (
        (0.0, 0.0, 0.0),
        (1.0, 1.0, 0.0),
        (1.0, 5.0, 5.0),
        (2.0, 6.0, 5.0),
    )
    mover = worlds.Mover(0.5, key_frames)
    assert mover.position(1.0) == (1.0, 0.0)
    assert mover.position(1.0 + 1e-9) == pytest.approx((5.0, 5.0))


def test_an_animation_that_does_not_repeat_stays_at_its_end():
    key_frames = (
        (1.0, 0.0, 1.0),
        (2.0, 4.0, 1.0),
    )
    mover = worlds.Mover(0.5, key_frames, length=3.0, repeat=False)
    assert mover.position(0.0) == (0.0, 1.0)
    assert mover.position(2.0) == (4.0, 1.0)
    assert mover.position(50.0) == (4.0, 1.0)


def test_the_circles_of_a_world_are_those_of_each_mover():
    standing = worlds.Mover(0.5, ((1.0, 0.0, 1.0), (2.0, 4.0, 1.0)), repeat=False)
    turning = worlds.Mover(0.2, ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (3.0, 2.0, 2.0)))
    world = small_world(movers=[turning, standing, turning])
    for time in (0.0, 0.4, 1.0, 1.5, 2.9, 7.3, 50.0):
        turning_circle = (*turning.position(time), 0.2)
        standing_circle = (*standing.position(time), 0.5)
        circles = [turning_circle, standing_circle, turning_circle]
        assert world.mover_circles(time).tolist() == list(map(list, circles))
    assert small_world().mover_circles(0.0).shape == (0, 3)


def test_the_course_is_the_challenges_even_beside_a_path_file(tmp_path):
    # Given: a world of DynaBARN beside the path of BARN's world with the same number
    table(
        tmp_path,
        "easylibobs_1,4,1,0,0,0",
        "easylibobs_1,4,1,4,1,1",
    )
    cells = np.column_stack([np.full(66, 15), np.arange(66)])
    world = world_of(tmp_path, "world_7.world", moving("easylibobs_1"), "", cells=cells)
    course = world.course

    assert course.start == (11.0, 0.0, math.pi)
    assert course.goal == (-9.0, 0.0, math.pi)
    assert course.goal_tolerance == 1.0
    assert course.length_m == 19.0
    assert not course.arrived(-7.9, 0.0)
    assert course.arrived(-8.1, 0.0)
    assert not course.planner_ends
    # The map ends 20 m from the start.
    assert course.sent_goal == pytest.approx((-8.7, 0.0, math.pi))


@pytest.mark.parametrize(
    ("room", "speeds", "counts", "who_looks"),
    [
        ("dynamic:0", (0.3, 0.95), (6, 12), [False, False, False]),
        ("dynamic:4", (0.8, 1.5), (8, 18), [False, False, False]),
        ("dynamic:5", (1.4, 1.95), (10, 24), [False, False, False]),
        # One of three looks at a telephone.
        ("people:0", (0.5, 1.5), (8, 18), [False, True, True]),
        ("people:1", (0.5, 1.5), (8, 18), [False, True, True]),
    ],
)
def test_movers_cross_the_room_at_the_pace_of_their_kind(room, speeds, counts, who_looks):
    world = worlds.load(room)
    assert worlds.load(room).movers == world.movers
    fewest, most = counts
    slowest, fastest = speeds
    assert fewest <= len(world.movers) <= most
    looks = [mover.looks for mover in world.movers]
    assert looks == (most * who_looks)[: len(looks)]
    for mover in world.movers:
        key_frames = np.array(mover.waypoints)
        times = key_frames[:, 0]
        points = key_frames[:, 1:]
        assert np.abs(points).max() <= dynabarn.HALF_SIDE_M
        # The shortest legs get a longer time than their length would need.
        legs = step_lengths(points)
        is_long = legs > dynabarn.SHORTEST_LEG_M
        speeds = legs[is_long] / np.diff(times)[is_long]
        assert speeds.min() >= slowest - 1e-9
        assert speeds.max() <= fastest + 1e-9
