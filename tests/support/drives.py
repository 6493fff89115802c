"""Drives made of numbers, for tests of what reads drives."""

import numpy as np

from applr_ros1.drives.drive import Decision, Drive, Motion


def driven(time, pose, twist=None, theta=(), decided=()):
    """Return a drive along true poses (n, 3), with parameter sets theta (k, p) from the times decided (k,) on."""
    time, pose = np.asarray(time, float), np.asarray(pose, float)
    twist = np.zeros((len(time), 2)) if twist is None else np.asarray(twist, float)
    decisions = [
        Decision("goal", at, at, {}, dict(enumerate(values)), None)
        for at, values in zip(decided, theta)
    ]
    return Drive(truth=Motion(time, time, pose, twist), decisions=decisions)
