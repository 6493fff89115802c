"""Drives for tests of events and reasons, made of measured velocities."""

from dataclasses import replace

import numpy as np

from applr_ros1.drives.drive import TIMED_OUT, Commands, Drive, Goal, Motion, Plans

RATE_HZ = 20.0
DRIVES = [(0.5, 0.0)] * 60  # three seconds at full speed
STANDS = [(0.0, 0.0)] * 60


def drive_of(twists, goal=(100.0, 0.0), sideways=0.0):
    """Return a drive with these measured velocities (v, w), which had a goal all the time.

    `sideways` is the velocity to the left [m/s], or one for each.
    """
    twist = np.array(twists, float)
    leftward = np.broadcast_to(np.asarray(sideways, float), len(twist)).copy()
    v, w = twist.T
    times = np.arange(len(twist)) / RATE_HZ
    yaw = np.cumsum(w) / RATE_HZ
    x = np.cumsum(v * np.cos(yaw) - leftward * np.sin(yaw)) / RATE_HZ
    y = np.cumsum(v * np.sin(yaw) + leftward * np.cos(yaw)) / RATE_HZ
    odometry = Motion(times, times, np.column_stack([x, y, yaw]), twist, leftward)
    # A plan of one pose, the goal's, in each row
    plan = np.array([(*goal, 0.0)])
    commands = Commands(times, twist, leftward)
    last_time = float(times[-1])
    return Drive(
        odometry=odometry,
        truth=odometry,
        plans=Plans(times, [plan] * len(times)),
        planned=commands,
        commands=commands,
        goals=[Goal("one", 0.0, last_time, TIMED_OUT)],
    )


def stopped_drive():
    """Return a drive that stands from 3 to 6 s, although 0.5 m/s are commanded."""
    drive = drive_of(DRIVES + STANDS + DRIVES)
    twists = np.tile([0.5, 0.0], (len(drive.odometry), 1))
    commands = Commands(drive.odometry.time, twists)
    return replace(drive, planned=commands, commands=commands)
