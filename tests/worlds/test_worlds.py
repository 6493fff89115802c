"""Tests of worlds of all kinds: names, splits, scale, commands that write pictures and files."""

import numpy as np
import pytest

import worlds
from applr_ros1 import robots
from applr_ros1.planner.costmap import footprint
from tests.support.refusals import refused
from tests.support.scenes import refused_world, small_world
from worlds import Mover, draw, dynabarn, sdf_writer
from worlds.occupancy import occupancy
from worlds.world import clearance

# Narrowest gap of BARN's worlds over the Jackal's padded width [m / m].
JACKAL_RATIO = 0.75 / 0.53


# -- names and splits
@pytest.mark.parametrize("spec", ["generated:300", "generated:x", "nothing", "", "generated:²"])
def test_unknown_world_is_one_line(spec):
    refused_world(spec, "generated:N")


@pytest.mark.parametrize(
    "spec", ["fresh:", "fresh:7-5", "fresh:-1", "fresh:1e3", "dynamic:training"]
)
def test_unknown_sets_of_worlds_are_one_line(spec):
    family, _, _ = spec.partition(":")
    refused(lambda: worlds.specs(spec), f"{family}:N-M")


def test_splits_share_no_world():
    training_worlds = set(worlds.specs("generated:train"))
    test_worlds = set(worlds.specs("generated:test"))
    # `train` in two parts
    validation_worlds = set(worlds.specs("generated:validation"))
    learning_worlds = set(worlds.specs("generated:learn"))
    assert validation_worlds | learning_worlds == training_worlds
    assert validation_worlds.isdisjoint(learning_worlds)
    assert training_worlds.isdisjoint(test_worlds)
    assert set(dynabarn.SPLITS["test"]).isdisjoint(dynabarn.SPLITS["validation"])


def test_the_numbers_of_a_split_never_change():
    validation = worlds.specs("generated:validation")
    assert validation[:3] == ["generated:5", "generated:14", "generated:24"]
    assert len(validation) == 31
    names = [world.name for world in worlds.Worlds("dynamic:validation")]
    assert names == [f"dynamic:{number}" for number in range(50, 100)]


# -- scale
@pytest.mark.parametrize("name", robots.NAMES)
def test_gaps_keep_their_ratio_to_the_padded_width(name):
    robot = robots.load(name)
    costmap = robot.parameters()["local_costmap"]
    corners = footprint.parse(str(costmap["footprint"]))
    # 0.01 m is costmap_2d's default.
    outline = footprint.pad(corners, costmap.get("footprint_padding", 0.01))
    _, y = np.transpose(outline)
    gap = 0.75 * robot.world_scale
    assert gap / np.ptp(y) == pytest.approx(JACKAL_RATIO, rel=0.01)


@pytest.mark.parametrize("spec", ["fresh:3", "physical_course", "dynamic:0"])
def test_everything_of_a_world_scales(spec):
    world = worlds.load(spec)
    half_size = worlds.scaled(world, 0.5)
    assert worlds.scaled(world, 1.0) is world
    assert np.allclose(half_size.cylinders, 0.5 * world.cylinders)
    # x, y, yaw, size_x, size_y
    factors = (0.5, 0.5, 1.0, 0.5, 0.5)
    assert np.allclose(half_size.boxes, world.boxes * factors)
    for half_mover, mover in zip(half_size.movers, world.movers):
        assert half_mover.radius == 0.5 * mover.radius

    assert np.allclose(half_size.course.path, 0.5 * world.course.path)
    assert half_size.course.length_m == pytest.approx(0.5 * world.course.length_m)
    for half_pose, pose in (
        (half_size.course.start, world.course.start),
        (half_size.course.goal, world.course.goal),
    ):
        x, y, yaw = pose
        assert half_pose == (0.5 * x, 0.5 * y, yaw)


def test_a_room_with_moving_obstacles_is_never_enlarged():
    for spec, is_enlarged in (
        ("fresh:3", True),
        ("physical_course", True),
        ("dynamic:0", False),
        ("people:0", False),
    ):
        world = worlds.load(spec)
        assert (worlds.scaled(world, 1.3) is not world) == is_enlarged, spec


def test_the_path_of_the_physical_course_keeps_from_its_boxes():
    world = worlds.load("physical_course")
    assert clearance(world, world.course.path).min() >= 0.3


def test_the_distance_to_a_moving_obstacle_is_that_at_the_given_time():
    # Given: a cylinder that is at (2, 0) after two of four seconds
    mover = Mover(0.5, ((0.0, 0.0, 0.0), (4.0, 4.0, 0.0)))
    world = small_world(cylinders=[(2.0, 9.0, 0.5)], movers=[mover])
    points = np.array([(2.0, 1.5), (0.0, 1.5)])

    at_start = clearance(world, points, world.mover_circles(0.0))
    halfway = clearance(world, points, world.mover_circles(2.0))

    # It has the first point beside it at one time, and the second one at the other.
    assert at_start == pytest.approx([2.5 - 0.5, 1.5 - 0.5])
    assert halfway == pytest.approx([1.5 - 0.5, 2.5 - 0.5])


def test_the_map_of_a_world_has_the_obstacles_that_stand():
    resolution = 0.05
    mover = Mover(0.5, ((0.0, 4.0, 0.0), (4.0, 4.0, 1.0)))
    world = small_world([(1.0, 2.0, 0.3)], [(-1.0, 0.0, 0.0, 0.6, 0.2)], [mover])
    cells, _, (origin_x, origin_y, _) = occupancy(world, resolution)
    rows, columns = np.nonzero(cells == 100)
    x = origin_x + (columns + 0.5) * resolution
    y = origin_y + (rows + 0.5) * resolution
    is_round = y > 1.0
    # An obstacle has the cells into whose inner circle it reaches.
    radii = np.hypot(x[is_round] - 1.0, y[is_round] - 2.0)
    assert 0.3 < radii.max() <= 0.3 + 0.5 * resolution
    for coordinate, low, high in ((x, -1.3, -0.7), (y, -0.1, 0.1)):
        assert coordinate[~is_round].min() == pytest.approx(low, abs=resolution)
        assert coordinate[~is_round].max() == pytest.approx(high, abs=resolution)


# -- commands
def test_commands_write_a_picture_and_a_world(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "out.png"
    world_file = tmp_path / "out.world"
    for main, written_file, first_bytes in (
        (draw.main, picture, b"\x89PNG"),
        (sdf_writer.main, world_file, b"<?xml"),
    ):
        monkeypatch.setattr("sys.argv", ["command", "generated:7", str(written_file)])
        assert main() == 0
        assert written_file.read_bytes().startswith(first_bytes)
    world = worlds.load("generated:7")
    read_world = worlds.load(str(world_file))
    assert len(read_world.cylinders) == len(world.cylinders)


@pytest.mark.parametrize(
    ("command", "out"),
    [
        (draw, "/nowhere/out.png"),
        (sdf_writer, "/nowhere/w.world"),
    ],
)
def test_a_file_that_cannot_be_written_is_one_line(command, out, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["command", "generated:7", out])
    assert command.main() == 1
    error_message = capsys.readouterr().err
    assert error_message.startswith(("draw: ", "sdf_writer: "))
    assert error_message.count("\n") == 1
