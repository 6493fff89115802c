"""Tests of the generator of BARN worlds: its rules, the built-in worlds, and their passability."""

import numpy as np
import pytest

import worlds
from tests.support.refusals import refused
from worlds import barn, search


def test_kinds_follow_barns_numbering():
    kinds = {
        0: (0.15, 2),
        24: (0.15, 2),
        25: (0.15, 3),
        75: (0.20, 2),
        150: (0.25, 2),
        299: (0.30, 4),
    }
    assert {number: barn.kind(number) for number in kinds} == kinds


@pytest.mark.parametrize("number", [7, 190])
def test_built_in_worlds_are_the_generators(number):
    filled, path = barn.generate_field(number)
    stored_filled, stored_path = barn.fields()[number]
    assert np.array_equal(filled, stored_filled)
    assert np.array_equal(path, stored_path)


def test_every_built_in_world_has_room_along_its_path():
    for number, (_, path) in barn.fields().items():
        world = barn.world(number)
        distance = np.hypot(
            *(world.course.path[:, None] - world.cylinders[None, :, :2]).transpose(2, 0, 1)
        )
        assert (distance - world.cylinders[:, 2]).min() >= 0.375 - 1e-9, number
        steps = np.diff(path, axis=0)
        assert np.abs(steps).max() == 1
        assert (np.abs(steps).sum(axis=1) > 0).all()
        assert (path[0, 1], path[-1, 1]) == (0, 29)
        turns = np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))))
        assert (turns <= np.pi / 4 + 1e-9).all()


def test_course_is_the_papers():
    course = worlds.load("generated:7").course
    x, y = course.path[0]
    assert course.start == (pytest.approx(x), 4.075, pytest.approx(np.pi / 2))
    assert (course.path[0, 1], course.length_m) == (pytest.approx(5.175), pytest.approx(5.925))
    assert (course.goal[0], course.goal[1]) == (
        pytest.approx(course.path[-1, 0]),
        pytest.approx(9.525 + 5.0),
    )
    assert not course.arrived(x, 9.99)
    assert course.arrived(x, 10.01)
    assert course.route_m >= 5.925


def test_cylinders_are_barns():
    world = worlds.load("generated:7")
    assert world.cylinders.shape[1] == 3
    assert (world.cylinders[:, 2] == 0.075).all()
    assert world.boxes.shape == (0, 5)
    filled, _ = barn.fields()[7]
    assert len(world.cylinders) == filled.sum() + 30 + 2 * 33
    assert np.array_equal(barn.fill_of(world.cylinders), filled)
    assert world.cylinders[:, 0].min() == pytest.approx(-4.425)
    assert world.cylinders[:, 1].min() == pytest.approx(0.075)


def test_fill_agrees_with_barns_figures():
    fill = [barn.fill_of(barn.world(n).cylinders).mean() for n in range(300)]
    assert np.quantile(fill, (0.05, 0.5, 0.95)) == pytest.approx([0.11, 0.18, 0.28], abs=0.01)


def test_barn_path_keeps_its_rule_on_turns_and_its_obstacle_penalty():
    free = np.ones((30, 30), dtype=bool)
    free[[0, 1, 2, 27, 28, 29]] = False
    path = search.barn_path(free, (3, 0), (3, 29))
    assert (tuple(path[0]), tuple(path[-1]), search.obstacle_penalty(free)[3, 5]) == (
        (3, 0),
        (3, 29),
        5.0,
    )
    assert (search.obstacle_penalty(free)[4, 5], search.obstacle_penalty(free)[5, 5]) == (2.5, 0.0)
    free[:, 12] = False
    assert search.barn_path(free, (3, 0), (3, 29)) is None


def test_fresh_worlds_are_the_recipes_and_none_of_the_built_in_ones():
    made = worlds.Worlds("fresh:5-7")
    assert [w.name for w in made] == worlds.specs("fresh:5-7") == ["fresh:5", "fresh:6", "fresh:7"]
    again = worlds.load("fresh:6")
    np.testing.assert_array_equal(made[1].cylinders, again.cylinders)
    np.testing.assert_array_equal(made[1].course.path, again.course.path)
    built_in = {w.cylinders.tobytes() for w in worlds.Worlds("generated:test,generated:train")}
    assert not built_in & {w.cylinders.tobytes() for w in worlds.Worlds("fresh:0-39")}
    refused(lambda: worlds.load("fresh:5-7"), "names 3 worlds")


def test_final_worlds_are_a_hundred_of_all_kinds_and_stay_as_they_were_drawn():
    """No other set contains a final world. A change of the generator or of the seed fails this
    test.
    """
    assert len(worlds.specs("final:0-99")) == 100
    refused(lambda: worlds.load("final:100"), "final:100")
    final = list(worlds.Worlds("final:0-5,final:99"))
    others = list(worlds.Worlds("fresh:0-19")) + [barn.world(number) for number in range(0, 300, 3)]
    assert not {w.cylinders.tobytes() for w in final} & {w.cylinders.tobytes() for w in others}
    assert sorted({barn.kind(3 * number) for number in range(100)}) == sorted(
        {barn.kind(n) for n in range(300)}
    )
    assert [len(w.cylinders) for w in final] == [205, 202, 192, 223, 188, 202, 325]


def test_fresh_worlds_are_generated_when_asked_for(monkeypatch):
    from worlds import loading

    made = []
    generate = barn.generate
    monkeypatch.setattr(
        loading.barn, "generate", lambda number: made.append(number) or generate(number)
    )
    some = worlds.Worlds("generated:3, fresh:0-9999")
    assert len(some) == 10_001
    assert made == []
    assert (some[0].name, some[5].name) == ("generated:3", "fresh:4")
    assert len(made) == 1
    with pytest.raises(IndexError):
        some[10_001]
