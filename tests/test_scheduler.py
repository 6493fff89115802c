"""Which worlds an actor is sent to: a curriculum from the easiest to all."""

import numpy as np
import pytest

from training.gorila.config import TrainConfig
from training.gorila.scheduler import TaskScheduler, easiest_first
from worlds import WorldError


def test_curriculum_opens_from_the_easiest_quarter_to_all():
    config = TrainConfig(steps=1000, curriculum=0.5).resolved()
    order = np.arange(40)[::-1]
    t = TaskScheduler(config, 40, order)
    assert t.next_task(0) is None  # before there is a policy
    t.ready = True
    first = {t.next_task(0).world for _ in range(300)}
    assert first == set(range(30, 40))
    t.transitions = 500
    assert {t.next_task(0).world for _ in range(2000)} == set(range(40))


def test_easiest_world_first():
    worlds = pytest.importorskip("worlds")
    few = [worlds.load("generated:%d" % i) for i in (0, 80, 160, 299)]
    order = easiest_first(few)
    assert sorted(order) == [0, 1, 2, 3]
    assert order[0] == 0
    assert order[-1] in (2, 3)


def test_a_curriculum_of_worlds_without_a_difficulty_is_one_line():
    worlds = pytest.importorskip("worlds")
    line = "a curriculum orders worlds by .*: physical_course is not on BARN's grid"
    with pytest.raises(WorldError, match=line) as no:
        easiest_first([worlds.load("generated:0"), worlds.load("physical_course")])
    assert "\n" not in str(no.value)
