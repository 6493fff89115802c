"""Worlds of the recipes at a robot's scale: the narrowest gap keeps its ratio to the robot's padded width."""

import numpy as np
import pytest

import worlds
from applr_ros1 import robots
from applr_ros1.planner.costmap import footprint

JACKAL_RATIO = 0.75 / 0.53


@pytest.mark.parametrize("name", robots.NAMES)
def test_gaps_keep_their_ratio_to_the_padded_width(name):
    robot = robots.load(name)
    local = robot.parameters()["local_costmap"]
    outline = footprint.pad(footprint.parse(str(local["footprint"])), local.get("footprint_padding", 0.01))
    width = np.ptp(np.asarray(outline)[:, 1])
    assert 0.75 * robot.world_scale / width == pytest.approx(JACKAL_RATIO, rel=0.01)


@pytest.mark.parametrize("spec", ["fresh:3", "physical_course"])
def test_everything_of_a_world_scales(spec):
    world = worlds.load(spec)
    half = worlds.scaled(world, 0.5)
    assert worlds.scaled(world, 1.0) is world
    assert np.allclose(half.cylinders, 0.5 * world.cylinders)
    assert np.allclose(half.boxes[:, [0, 1, 3, 4]], 0.5 * world.boxes[:, [0, 1, 3, 4]])
    assert np.array_equal(half.boxes[:, 2], world.boxes[:, 2])
    assert np.allclose(half.course.path, 0.5 * world.course.path)
    assert half.course.length_m == pytest.approx(0.5 * world.course.length_m)
    assert half.course.start[2] == world.course.start[2]


def test_a_world_from_a_file_keeps_its_size(tmp_path):
    from worlds import sdf_writer

    path = str(tmp_path / "hall.world")
    sdf_writer.write(worlds.load("generated:7"), path)
    hall = worlds.load(path)
    assert worlds.scaled(hall, 0.5) is hall
