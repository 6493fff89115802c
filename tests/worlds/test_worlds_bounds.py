"""Open worlds and huge ones: their picture and their map."""

from dataclasses import replace

import numpy as np
import pytest

import worlds
from applr_ros1.common.files import MAX_CELLS
from worlds.draw import top_view
from worlds.dynabarn import arena_course
from worlds.occupancy import occupancy

MOVER = worlds.Mover(0.5, ((0.0, 1.0, 2.0), (1.5, 2.0, 2.5)))
OPEN = worlds.World("open", np.zeros((0, 3)), np.zeros((0, 5)), arena_course(), (MOVER,))
TINY = replace(OPEN, movers=())


@pytest.mark.parametrize("world", [OPEN, TINY], ids=["movers", "nothing"])
def test_a_world_without_standing_obstacles_has_a_picture(world):
    picture = top_view(world, world.course.start)
    assert picture.shape[2] == 3
    assert picture.shape[1] > picture.shape[0]  # as long as the course, a metre to each side
    assert picture.min() < 255


def test_a_map_of_too_many_cells_is_refused_before_it_is_made():
    far = replace(TINY, boxes=np.array([[0.0, 0.0, 0.0, 1.0, 1.0], [2000.0, 2000.0, 0.0, 1.0, 1.0]]))
    with pytest.raises(worlds.WorldError, match="open is 20.. x 20.. m, .* cells of 0.05 m: give .* at most") as no:
        occupancy(far)
    assert "\n" not in str(no.value)
    cells, _ = occupancy(far, 1.0)
    assert cells.size <= MAX_CELLS
