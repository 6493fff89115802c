"""Tests of the generator of BARN worlds: its rules, the built-in worlds, and their passability."""

import numpy as np
import pytest

import worlds
from tests.support.refusals import refused
from worlds import barn, search
from worlds.world import clearance


def fields_of(specification):
    """Return the cylinders of each of some worlds, as bytes."""
    return {world.cylinders.tobytes() for world in worlds.Worlds(specification)}


def test_kinds_follow_barns_numbering():
    # number: (fill probability, smoothing rounds)
    expected_kinds = {
        0: (0.15, 2),
        24: (0.15, 2),
        25: (0.15, 3),
        75: (0.20, 2),
        150: (0.25, 2),
        299: (0.30, 4),
    }
    for number, kind in expected_kinds.items():
        assert barn.kind(number) == kind, number


@pytest.mark.parametrize("number", [7, 190])
def test_built_in_worlds_are_the_generators(number):
    filled, path = barn.generate_field(number)
    stored_filled, stored_path = barn.fields()[number]
    assert np.array_equal(filled, stored_filled)
    assert np.array_equal(path, stored_path)


def test_every_built_in_world_has_room_along_its_path():
    for number in barn.fields():
        world = barn.world(number)
        # Half of the narrowest gap of 0.75 m
        assert clearance(world, world.course.path).min() >= 0.375 - 1e-9, number


def test_course_is_the_papers():
    course = worlds.load("generated:7").course
    first_x, first_y = course.path[0]
    last_x, _ = course.path[-1]
    start_x, start_y, start_yaw = course.start
    assert start_x == pytest.approx(first_x)
    assert start_y == 4.075
    assert start_yaw == pytest.approx(np.pi / 2)
    assert first_y == pytest.approx(5.175)
    assert course.length_m == pytest.approx(5.925)
    assert course.goal[:2] == pytest.approx((last_x, 9.525 + 5.0))
    assert not course.arrived(first_x, 9.99)
    assert course.arrived(first_x, 10.01)
    assert course.route_m >= 5.925


def test_cylinders_are_barns():
    world = worlds.load("generated:7")
    assert world.cylinders.shape[1] == 3
    x, y, radius = world.cylinders.T
    assert (radius == 0.075).all()
    assert world.boxes.shape == (0, 5)
    filled, _ = barn.fields()[7]
    # Back wall and both sides of the corridor before the field
    corridor_count = 30 + 2 * 33
    assert len(world.cylinders) == filled.sum() + corridor_count
    assert np.array_equal(barn.fill_of(world.cylinders), filled)
    assert x.min() == pytest.approx(-4.425)
    assert y.min() == pytest.approx(0.075)


def test_fill_agrees_with_barns_figures():
    shares = []
    for number in range(300):
        filled = barn.fill_of(barn.world(number).cylinders)
        shares.append(filled.mean())
    quantiles = np.quantile(shares, (0.05, 0.5, 0.95))
    assert quantiles == pytest.approx([0.11, 0.18, 0.28], abs=0.01)


def test_barn_path_keeps_its_rule_on_turns_and_its_obstacle_penalty():
    # Given: a corridor between two walls, and a path along one of them
    free = np.ones((30, 30), dtype=bool)
    free[[0, 1, 2, 27, 28, 29]] = False
    start = (3, 0)
    goal = (3, 29)
    path = search.barn_path(free, start, goal)
    assert tuple(path[0]) == start
    assert tuple(path[-1]) == goal

    # The penalty falls with the distance from the wall.
    penalty = search.obstacle_penalty(free)
    assert penalty[3, 5] == 5.0
    assert penalty[4, 5] == 2.5
    assert penalty[5, 5] == 0.0

    # A wall across the corridor leaves no path.
    free[:, 12] = False
    assert search.barn_path(free, start, goal) is None


def test_fresh_worlds_are_the_recipes_and_none_of_the_built_in_ones():
    world_names = ["fresh:5", "fresh:6", "fresh:7"]
    fresh_worlds = worlds.Worlds("fresh:5-7")
    assert worlds.specs("fresh:5-7") == world_names
    assert [world.name for world in fresh_worlds] == world_names
    reloaded = worlds.load("fresh:6")
    np.testing.assert_array_equal(fresh_worlds[1].cylinders, reloaded.cylinders)
    np.testing.assert_array_equal(fresh_worlds[1].course.path, reloaded.course.path)
    assert not fields_of("fresh:0-39") & fields_of("generated:test,generated:train")
    refused(lambda: worlds.load("fresh:5-7"), "names 3 worlds")


def test_final_worlds_are_a_hundred_of_all_kinds_and_stay_as_they_were_drawn():
    """No other set contains a final world. A change of the generator or of the seed fails this
    test.
    """
    assert len(worlds.specs("final:0-99")) == 100
    refused(lambda: worlds.load("final:100"), "final:100")
    some_worlds = "final:0-5,final:99"
    other_worlds = "fresh:0-19,generated:test,generated:train"
    assert not fields_of(some_worlds) & fields_of(other_worlds)
    final_kinds = {barn.kind(3 * number) for number in range(100)}
    assert final_kinds == {barn.kind(number) for number in range(300)}
    cylinder_counts = [len(world.cylinders) for world in worlds.Worlds(some_worlds)]
    assert cylinder_counts == [205, 202, 192, 223, 188, 202, 325]


def test_fresh_and_dynamic_worlds_stay_as_they_were_drawn():
    """Policies and sets were chosen and judged in these worlds."""
    cylinder_counts = [len(world.cylinders) for world in worlds.Worlds("fresh:0-4")]
    assert cylinder_counts == [191, 206, 212, 223, 216]
    rooms = list(worlds.Worlds("dynamic:0-2,dynamic:50,people:0"))
    assert [len(room.movers) for room in rooms] == [10, 15, 22, 13, 16]
    # Radius and speeds of a mover are drawn after its path.
    radii = [room.movers[0].radius for room in rooms]
    assert radii == pytest.approx([0.46698, 0.39327, 0.43149, 0.28571, 0.39353], abs=1e-5)
    durations = [room.movers[0].length for room in rooms]
    assert durations == pytest.approx([34.7267, 24.3593, 9.7592, 24.4157, 36.8989], abs=1e-4)


def test_fresh_worlds_are_generated_when_asked_for(monkeypatch):
    from worlds import loading

    generated_numbers = []
    generate = barn.generate

    def note(number):
        generated_numbers.append(number)
        return generate(number)

    monkeypatch.setattr(loading.barn, "generate", note)
    lazy_worlds = worlds.Worlds("generated:3, fresh:0-9999")
    assert len(lazy_worlds) == 10_001
    assert generated_numbers == []
    assert lazy_worlds[0].name == "generated:3"
    assert lazy_worlds[5].name == "fresh:4"
    assert len(generated_numbers) == 1
    with pytest.raises(IndexError):
        lazy_worlds[10_001]
