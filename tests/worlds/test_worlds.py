"""Tests of worlds of all kinds: names, splits, scale, and the commands that write pictures and
files.
"""

import numpy as np
import pytest

import worlds
from applr_ros1 import robots
from applr_ros1.planner.costmap import footprint
from tests.support.refusals import refused
from tests.support.scenes import refused_world
from worlds import barn, draw, dynabarn, sdf_writer
from worlds.world import clearance

JACKAL_RATIO = 0.75 / 0.53


# -- names and splits
@pytest.mark.parametrize("spec", ["generated:300", "generated:x", "nothing", "", "generated:²"])
def test_unknown_world_is_one_line(spec):
    refused_world(spec, "generated:N")


@pytest.mark.parametrize(
    "spec", ["fresh:", "fresh:7-5", "fresh:-1", "fresh:1e3", "dynamic:training"]
)
def test_unknown_sets_of_worlds_are_one_line(spec):
    refused(lambda: worlds.specs(spec), spec.partition(":")[0] + ":N-M")


def test_splits_share_no_world():
    names = {split: set(worlds.specs("generated:" + split)) for split in barn.SPLITS}
    assert names["validation"] | names["learn"] == names["train"]
    assert not names["validation"] & names["learn"]
    assert not names["train"] & names["test"]
    # The numbers must never change.
    assert worlds.specs("generated:validation")[:3] == [f"generated:{n}" for n in (5, 14, 24)]
    assert len(names["validation"]) == 31
    assert not set(dynabarn.SPLITS["test"]) & set(dynabarn.SPLITS["validation"])
    assert [w.name for w in worlds.Worlds("dynamic:validation")] == [
        "dynamic:%d" % n for n in range(50, 100)
    ]


# -- scale
@pytest.mark.parametrize("name", robots.NAMES)
def test_gaps_keep_their_ratio_to_the_padded_width(name):
    robot = robots.load(name)
    local = robot.parameters()["local_costmap"]
    outline = footprint.pad(
        footprint.parse(str(local["footprint"])), local.get("footprint_padding", 0.01)
    )
    width = np.ptp(np.asarray(outline)[:, 1])
    assert 0.75 * robot.world_scale / width == pytest.approx(JACKAL_RATIO, rel=0.01)


@pytest.mark.parametrize("spec", ["fresh:3", "physical_course", "dynamic:0"])
def test_everything_of_a_world_scales(spec):
    world = worlds.load(spec)
    half = worlds.scaled(world, 0.5)
    assert worlds.scaled(world, 1.0) is world
    assert np.allclose(half.cylinders, 0.5 * world.cylinders)
    assert np.allclose(half.boxes[:, [0, 1, 3, 4]], 0.5 * world.boxes[:, [0, 1, 3, 4]])
    assert np.array_equal(half.boxes[:, 2], world.boxes[:, 2])
    assert [mover.radius for mover in half.movers] == [0.5 * mover.radius for mover in world.movers]
    assert np.allclose(half.course.path, 0.5 * world.course.path)
    assert half.course.length_m == pytest.approx(0.5 * world.course.length_m)
    assert (half.course.start[2], half.course.goal[0]) == (
        world.course.start[2],
        0.5 * world.course.goal[0],
    )
    # A room with moving obstacles is never enlarged.
    assert (worlds.scaled(world, 1.3) is world) == (spec == "dynamic:0")


def test_the_path_of_the_physical_course_keeps_from_its_boxes():
    world = worlds.load("physical_course")
    assert clearance(world, world.course.path).min() >= 0.3


# -- commands
def test_commands_write_a_picture_and_a_world(tmp_path, monkeypatch, capsys):
    for main, name, begin in (
        (draw.main, "out.png", b"\x89PNG"),
        (sdf_writer.main, "out.world", b"<?xml"),
    ):
        monkeypatch.setattr("sys.argv", ["command", "generated:7", str(tmp_path / name)])
        assert main() == 0
        assert (tmp_path / name).read_bytes().startswith(begin)
    copy = str(tmp_path / "out.world")
    assert len(worlds.load(copy).cylinders) == len(worlds.load("generated:7").cylinders)
    wrong = (
        (draw.main, "/nowhere/out.png"),
        (draw.main, "x.nonsense"),
        (sdf_writer.main, "/nowhere/w.world"),
    )
    for main, out in wrong:
        monkeypatch.setattr("sys.argv", ["command", "generated:7", out])
        assert main() == 1
        error = capsys.readouterr().err
        assert error.startswith(("draw: ", "sdf_writer: "))
        assert error.count("\n") == 1
