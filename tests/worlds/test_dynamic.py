"""Rooms of moving obstacles: the splits, the movers' pace, and how they scale."""

import numpy as np
import pytest

import worlds
from worlds import WorldError, dynabarn, scaled


def test_splits_share_no_world_and_numbers_give_the_same_room_again():
    assert not set(dynabarn.SPLITS["test"]) & set(dynabarn.SPLITS["validation"])
    assert [w.name for w in worlds.load_all("dynamic:validation")] == ["dynamic:%d" % n for n in range(50, 100)]
    assert worlds.load("dynamic:7").movers == worlds.load("dynamic:7").movers
    assert len(worlds.Worlds("dynamic:100-109,generated:7")) == 11
    with pytest.raises(WorldError, match="dynamic:N-M"):
        worlds.load_all("dynamic:training")


@pytest.mark.parametrize("number", range(6))
def test_movers_cross_the_room_at_the_pace_of_their_kind(number):
    world = worlds.load("dynamic:%d" % number)
    low, high = dynabarn.SPEEDS[number % 3]
    least, most = dynabarn.COUNTS[number % 3]
    assert least <= len(world.movers) <= most
    for mover in world.movers:
        frames = np.array(mover.waypoints)
        assert np.abs(frames[:, 1:]).max() <= dynabarn.HALF
        legs = np.hypot(*np.diff(frames[:, 1:], axis=0).T)
        pace = (legs / np.diff(frames[:, 0]))[legs > 0.05]
        assert low - 1e-9 <= pace.min() <= pace.max() <= high + 1e-9


def test_a_room_shrinks_with_the_robot_and_never_grows():
    world = worlds.load("dynamic:0")
    assert scaled(world, 1.3) is world
    small = scaled(world, 0.5)
    assert small.movers[0].radius == 0.5 * world.movers[0].radius
    assert small.course.goal[0] == 0.5 * world.course.goal[0]
