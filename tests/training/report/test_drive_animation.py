"""The animation of a drive: moving obstacles where the world's time puts them."""

import numpy as np
from PIL import Image, ImageColor

import worlds
from applr_ros1.drives import drawing
from worlds.draw import MOVER
from worlds.world import Mover

NOTHING = np.empty((0, 2))
FOOTPRINT = np.array([(-0.2, -0.2), (-0.2, 0.2), (0.2, 0.2), (0.2, -0.2)])


def last_frame(path, world, time, world_time=0.0):
    """(height, width, 3) of the animation's only frame, at `time` of a drive."""
    view = drawing.View(time, (0.0, 0.0, 0.0), NOTHING, NOTHING, NOTHING, NOTHING)
    drive = drawing.Drive(world, np.zeros((1, 5)), views=[view], world_time=world_time)
    drawing.save_animation(drive, FOOTPRINT, str(path / "a.gif"))
    with Image.open(path / "a.gif") as image:
        return np.asarray(image.convert("RGB"))


def of_colour(frame, colour):
    return (frame == ImageColor.getrgb(colour)).all(axis=2)


def wide_world():
    course = worlds.Course((6.0, 0.0, 3.1), (-6.0, 0.0, 3.1), None, 1.0, NOTHING)
    mover = Mover(radius=0.4, waypoints=((0.0, -4.0, -2.0), (8.0, 4.0, 2.0), (16.0, -4.0, -2.0)))
    return worlds.World("wide", np.empty((0, 3)), np.empty((0, 5)), course, (mover,))


def test_moving_obstacles_follow_the_worlds_time(tmp_path):
    world = wide_world()
    begins, driven, later = (
        of_colour(last_frame(tmp_path, world, time, world_time), MOVER)
        for time, world_time in ((0.0, 0.0), (3.0, 0.0), (0.0, 3.0))
    )
    assert begins.sum() > 200
    assert not np.array_equal(begins, driven)
    assert np.array_equal(driven, later)  # a drive that begins 3 s after the world
