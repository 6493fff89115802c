"""Tests of moving obstacles: DynaBARN's table of key frames, positions over time, and speeds in
generated rooms.
"""

import math
from pathlib import Path

import numpy as np
import pytest

import worlds
from tests.support.scenes import moving, refused_world, sdf, write_world
from worlds import dynabarn


def table(folder, *rows):
    path = folder / dynabarn.NAME
    path.write_text("\n".join((",".join(dynabarn.COLUMNS),) + rows) + "\n")
    return str(path)


def test_positions_over_time_equal_gazebos(tmp_path):
    """Catmull-Rom tangents with tension 0 between key frames, computed by hand. The animation
    repeats every 10 s.
    """
    rows = ["hardlibobs_7,10,1,%s" % row for row in ("0,0,0", "2,4,0", "4,4,4", "8,0,8")]
    file = Path(table(tmp_path, *rows))
    # The table has the byte order mark and line ends of Windows.
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    (mover,) = worlds.load(
        write_world(tmp_path, sdf(moving("hardlibobs_7")), "world_0.world")
    ).movers
    assert (mover.position(0.0), mover.position(2.0)) == ((0.0, 0.0), (4.0, 0.0))
    # Halfway: mean of the ends + 1/8 of the difference of their tangents, (2, 0) at the first and
    # (2, 2) at the next
    assert mover.position(1.0) == pytest.approx((2.0 + (2.0 - 2.0) / 8, 0.0 + (0.0 - 2.0) / 8))
    assert mover.position(3.0) == pytest.approx((4.0 + (2.0 - -2.0) / 8, 2.0 + (2.0 - 4.0) / 8))
    assert mover.position(6.0) == pytest.approx((2.0 + (-2.0 - -2.0) / 8, 6.0 + (4.0 - 2.0) / 8))
    assert (mover.position(9.0), mover.position(13.0)) == (
        (0.0, 8.0),
        pytest.approx(mover.position(3.0)),
    )
    two = write_world(tmp_path, sdf(moving("hardlibobs_7") + moving("lamp")), "world_1.world")
    refused_world(two, "'lamp' in .* the Gazebo plugin '.*lamp.so', which has no rows in")


def test_closed_paths_equal_times_and_animations_that_do_not_repeat():
    closed = worlds.Mover(0.5, ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (2.0, 2.0, 2.0), (3.0, 0.0, 0.0)))
    # The tangent at the first point is half the chord from the last point but one to the second
    # point.
    assert closed.position(0.5) == pytest.approx((1.0 + (0.0 - 1.0) / 8, 0.0 + (-1.0 - 1.0) / 8))
    jump = worlds.Mover(0.5, ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 5.0, 5.0), (2.0, 6.0, 5.0)))
    assert (jump.position(1.0), jump.position(1.0 + 1e-9)) == (
        (1.0, 0.0),
        pytest.approx((5.0, 5.0)),
    )
    once = worlds.Mover(0.5, ((1.0, 0.0, 1.0), (2.0, 4.0, 1.0)), 3.0, False)
    assert [once.position(t) for t in (0.0, 2.0, 50.0)] == [(0.0, 1.0), (4.0, 1.0), (4.0, 1.0)]


def test_the_course_is_the_challenges_even_beside_a_path_file(tmp_path):
    table(tmp_path, "easylibobs_1,4,1,0,0,0", "easylibobs_1,4,1,4,1,1")
    # Path of BARN's world with the same number.
    cells = np.column_stack([np.full(66, 15), np.arange(66)])
    course = worlds.load(
        write_world(tmp_path, sdf(moving("easylibobs_1"), ""), "world_7.world", cells=cells)
    ).course
    assert (course.start, course.goal) == ((11.0, 0.0, math.pi), (-9.0, 0.0, math.pi))
    assert (course.goal_tolerance, course.length_m) == (1.0, 19.0)
    assert not course.arrived(-7.9, 0.0)
    assert course.arrived(-8.1, 0.0)
    assert not course.planner_ends
    # The map ends 20 m from the start.
    assert course.sent_goal == pytest.approx((-8.7, 0.0, math.pi))


@pytest.mark.parametrize("number", range(6))
def test_movers_cross_the_room_at_the_pace_of_their_kind(number):
    world = worlds.load("dynamic:%d" % number)
    assert worlds.load("dynamic:%d" % number).movers == world.movers
    low, high = dynabarn.SPEEDS_M_S[number % 3]
    least, most = dynabarn.MOVER_COUNTS[number % 3]
    assert least <= len(world.movers) <= most
    for mover in world.movers:
        frames = np.array(mover.waypoints)
        assert np.abs(frames[:, 1:]).max() <= dynabarn.HALF_SIDE_M
        legs = np.hypot(*np.diff(frames[:, 1:], axis=0).T)
        pace = (legs / np.diff(frames[:, 0]))[legs > 0.05]
        assert low - 1e-9 <= pace.min() <= pace.max() <= high + 1e-9
