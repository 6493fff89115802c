"""Tells from the scans whether a goal is occupied, so that no path leads to it."""

from __future__ import annotations

import numpy as np

from applr_ros1.drives.frames import FrameTree
from applr_ros1.why.stretch import Stretch

# An obstacle occupies a goal that lies so much before, or behind, the surface that the laser sees
# [m, for the Jackal]: the inscribed radius of the footprint, and the depth of a usual obstacle.
BEFORE_M = 0.15
BEHIND_M = 0.5


def is_goal_occupied(stretch: Stretch, scale: float) -> bool:
    """Return whether the laser sees an obstacle at the goal, or right before it.

    False if the goal is out of sight, or if tf does not connect it with the laser.

    Args:
        stretch: The stretch in which somebody wants to know.
        scale: Size of the robot relative to the Jackal's.
    """
    drive = stretch.drive
    scans = stretch.part(drive.scans)
    sent_goals = [sent for sent in drive.sent if sent.time <= stretch.end]
    if scans is None or not sent_goals or not drive.frames.get("scans"):
        return False
    goal = sent_goals[-1]
    laser_frame = drive.frames["scans"][0]
    in_laser_frame = FrameTree(drive.transforms).place(laser_frame, goal.frame, scans.stamp)
    if in_laser_frame is None:
        return False
    goal_x, goal_y, _ = goal.pose
    x, y, _ = (in_laser_frame.position + in_laser_frame.rotation.apply((goal_x, goal_y, 0.0))).T

    # The beam of each scan that leads to the goal, and how far behind its end the goal lies
    first_angles, increments, _, _ = scans.fan.T
    beams = np.rint((np.arctan2(y, x) - first_angles) % (2.0 * np.pi) / increments)
    distances = np.hypot(x, y)
    occupied_count = 0
    for scan_row, (beam, distance) in enumerate(zip(beams, distances)):
        ranges = scans.distances(scan_row)
        if 0 <= beam < len(ranges):
            behind = (distance - ranges[int(beam)]) / scale
            occupied_count += -BEFORE_M <= behind <= BEHIND_M
    return occupied_count > stretch.share * len(scans)
