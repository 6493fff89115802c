"""Velocities of a whole recorded odometry: its own, or those that its poses show.

The monitor compares both while a robot drives (odometry_check.py); here the drive is over.
"""

from __future__ import annotations

import math
from typing import Iterator, List, NamedTuple, Tuple

import numpy as np

from applr_ros1.monitor.motion import PoseMotion
from applr_ros1.monitor.odometry_check import OdometryCheck

SPAN_S = 0.5  # time over which a velocity is measured from poses [s]

# Stamp [s], pose and velocity of a message, as plain numbers
Message = Tuple[float, List[float], List[float]]


class CheckedTwists(NamedTuple):
    """Velocities (n, 2) v [m/s], w [rad/s], and what is wrong with the recorded ones, or ""."""

    twist: np.ndarray
    problem: str


def checked_twists(stamps: np.ndarray, poses: np.ndarray, twists: np.ndarray) -> CheckedTwists:
    """Return the velocities of an odometry, by its poses if its own are left at 0.

    Args:
        stamps: Times of its messages (n,) [s].
        poses: Poses (n, 3) x, y [m], yaw [rad].
        twists: Velocities (n, 2) v [m/s], w [rad/s].
    """
    check = OdometryCheck()
    for stamp, (x, y, yaw), (v, w) in _messages(stamps, poses, twists):
        # What is said first stands for the whole drive.
        if check.take(stamp, (x, y, yaw), (v, w)):
            break
    if check.lacks_twist:
        twists = _by_poses(stamps, poses, twists)
    return CheckedTwists(twists, check.problem)


def _by_poses(stamps: np.ndarray, poses: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """Return the velocities (n, 2) that the poses show, v to all sides.

    They are the recorded ones if the poses are too rare to show any.
    """
    motion = PoseMotion(SPAN_S)
    middle_stamps = []
    velocities = []
    for stamp, (x, y, yaw), (recorded_v, _) in _messages(stamps, poses, twists):
        motion.take(stamp, (x, y, yaw), recorded_v)
        if not motion.baseline:  # Nothing is known at the begin and after a gap.
            continue
        # A velocity holds for the middle of the time over which it is measured.
        middle_stamps.append(stamp - motion.baseline / 2)
        # A base that drives sideways moves as well.
        speed = math.hypot(motion.velocity.v, motion.velocity.leftward)
        velocities.append((math.copysign(speed, motion.velocity.v), motion.velocity.w))
    if not velocities:
        return twists
    measured_v, measured_w = np.array(velocities).T
    v = np.interp(stamps, middle_stamps, measured_v)
    w = np.interp(stamps, middle_stamps, measured_w)
    return np.column_stack([v, w])


def _messages(stamps: np.ndarray, poses: np.ndarray, twists: np.ndarray) -> Iterator[Message]:
    """Yield the messages of an odometry."""
    return zip(stamps.tolist(), poses.tolist(), twists.tolist())
