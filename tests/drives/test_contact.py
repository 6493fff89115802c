"""Tests of applr_ros1/drives/contact.py: how fast the robot was when it was touched."""

import math

import numpy as np
import pytest

from applr_ros1.drives.contact import contact_in_words, contact_speed
from applr_ros1.drives.drive import Decision, Drive, Motion

TIMES = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
# The robot brakes, stands, and is pushed back from 1.5 s on.
SPEEDS = np.array([1.0, 0.4, 0.0, -0.7, -0.7])


def driven(contacts, has_truth=True):
    """Return a drive with contacts at some times [s]."""
    truth = None
    if has_truth:
        twist = np.column_stack([SPEEDS, np.zeros(5)])
        truth = Motion(TIMES, TIMES, np.zeros((5, 3)), twist)
    return Drive(truth=truth, contacts=np.array(contacts))


@pytest.mark.parametrize(
    ("contacts", "begin", "speed"),
    [
        ([1.0], 0.0, 0.4),  # The contact has stopped it.
        ([1.5, 2.0], 0.0, 0.0),  # The contact has pushed it.
        ([2.0], 0.0, 0.7),  # The magnitude counts.
        ([0.0, 1.0], 0.0, 0.4),  # A contact at the very beginning belongs to the course before.
        ([1.0, 2.0], 1.0, 0.7),
    ],
)
def test_the_speed_before_the_first_contact_of_a_course_counts(contacts, begin, speed):
    assert contact_speed(driven(contacts), begin) == speed


def test_without_a_contact_or_true_motion_or_its_time_the_speed_is_unknown():
    assert math.isnan(contact_speed(driven([])))
    assert math.isnan(contact_speed(driven([1.0], has_truth=False)))
    assert math.isnan(contact_speed(driven([math.inf])))


def test_a_kept_path_has_the_contacts_and_the_names_of_the_parameters():
    drive = driven([1.0])
    drive.decisions.append(Decision("", 0.5, 0.5, {}, {"max_vel_x": 0.75, "vx_samples": 6.0}, None))
    unpacked = Drive.unpack(drive.pack())
    assert contact_speed(unpacked) == pytest.approx(0.4)
    assert unpacked.decisions[0].after == {"max_vel_x": 0.75, "vx_samples": 6.0}
    without_decisions = Drive.unpack(driven([1.0]).pack())
    assert without_decisions.decisions == []


def test_a_contact_at_rest_is_told_from_one_in_motion():
    assert contact_in_words(0.0) == contact_in_words(0.04) == "stood when touched"
    assert contact_in_words(0.4) == "was touched at 0.4 m/s"
    # One decimal of a smaller speed would be 0.0 m/s.
    assert contact_in_words(0.06) == "was touched at 0.1 m/s"
    assert contact_in_words(math.nan) == "touched something"
