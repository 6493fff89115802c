"""Replays of simulated drives for tests."""

from functools import lru_cache

import numpy as np

from applr_ros1 import robots
from applr_ros1.drives.drive import Changes
from applr_ros1.why.recording import Recording
from applr_ros1.why.replay import replay_of
from tests.support.drives import changed, simulated

PLANNER = "TrajectoryPlannerROS"
JACKAL = robots.JACKAL
WAFFLE = robots.load("turtlebot3_waffle_pi")
# The fault of the spoilt drive: the planner samples only its slowest speed, 0.1 m/s.
FAULT = {PLANNER: {"vx_samples": 1}}


def replayed(robot, driven):
    """Return a replay that has run through a drive."""
    return replay_of(Recording.of(driven, robot))


@lru_cache(maxsize=None)
def spoilt_drive():
    """Return a Jackal with a fault, and a recording of its drive."""
    robot = changed(JACKAL, FAULT)
    drive, _ = simulated(robot, "generated:40", limit=12)
    return robot, drive


@lru_cache(maxsize=None)
def sound_replay():
    """Return a replay of a drive without a fault."""
    drive, _ = simulated(JACKAL, "generated:40", limit=8)
    return replayed(JACKAL, drive)


@lru_cache(maxsize=None)
def spoilt_replay():
    """Return a replay of the drive with the fault."""
    return replayed(*spoilt_drive())


def updates(*rows):
    """Return changes of parameters (time, server, values)."""
    times, servers, values = zip(*rows)
    return Changes(np.array(times), list(servers), list(values))
