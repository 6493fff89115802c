"""Tests of applr_ros1/why/touch.py: what touched the robot of a recorded drive."""

import re
from dataclasses import replace

import numpy as np
import pytest

import worlds
from applr_ros1 import robots
from applr_ros1.common.angles import compose
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import Diagnosis, diagnose
from applr_ros1.why.recording import Recording
from applr_ros1.why.touch import touch_of
from tests.support.drives import simulated
from tests.support.replays import replayed

JACKAL = robots.JACKAL
SPEED = 0.8  # of what comes [m/s]


@pytest.fixture(scope="module")
def recording():
    """Return a drive to the north that something from the left runs into."""
    world = worlds.load("generated:40")
    start_x, start_y, _ = world.course.start
    key_frames = []
    for time in range(12):
        key_frames.append((float(time), start_x - 3.0 + SPEED * time, start_y + 1.0))
    comes = worlds.Mover(0.4, tuple(key_frames), repeat=False)
    drive, _ = simulated(JACKAL, replace(world, movers=(comes,)), limit=5)
    return Recording.of(drive, JACKAL)


def test_a_touch_has_the_speeds_of_both_and_the_side_that_the_other_came_from(recording):
    touch = touch_of(recording)
    assert touch.time == recording.drive.contacts[0]
    assert touch.mover_speed == pytest.approx(SPEED, abs=0.15)
    assert touch.side == "the left"
    pattern = r"was touched at 0.\d m/s by something that came from the left at 0.\d m/s.$"
    assert re.search(pattern, str(touch))

    # A bag has no true motion.
    of_bag = replace(recording, drive=replace(recording.drive, truth=None))
    assert touch_of(of_bag).speed == pytest.approx(touch.speed, abs=0.15)
    assert str(touch._replace(speed=0.0, mover_speed=0.0)).endswith("the robot stood when touched.")


@pytest.mark.parametrize(
    ("turn", "side"),
    [(-np.pi / 2, "ahead"), (np.pi / 2, "behind"), (np.pi, "the right")],
    ids=["ahead", "behind", "right"],
)
def test_the_side_is_that_of_the_robot_whichever_way_it_faces(recording, turn, side):
    # The robot faces another way, and its laser the same as before: nothing else in the drive
    # changes.
    poses = recording.odometry.pose - (0.0, 0.0, turn)
    turned = replace(
        recording,
        odometry=replace(recording.odometry, pose=poses),
        laser_pose=compose((0.0, 0.0, turn), recording.laser_pose),
    )
    assert touch_of(turned).side == side


def test_a_contact_where_nothing_moves_says_so_and_without_one_there_is_no_touch(recording):
    early = replace(recording, drive=replace(recording.drive, contacts=np.array([1.0])))
    assert touch_of(early).side == ""
    untouched = replace(recording, drive=replace(recording.drive, contacts=np.empty(0)))
    assert touch_of(untouched) is None


def test_the_answer_begins_with_the_touch_unless_somebody_asks_about_a_moment(recording):
    words = str(touch_of(recording))
    replay = replayed(JACKAL, recording.drive)
    answer = answer_of(Diagnosis.of(replay, []))
    assert answer.first_line.startswith(f"{words} The robot did not stop")
    assert words not in answer_of(diagnose(replay, at=1.0)).first_line
