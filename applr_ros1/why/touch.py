"""First contact of a recorded drive, and what moved there according to the scans."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, Optional

import numpy as np

from applr_ros1.common.angles import normalize_angle
from applr_ros1.drives.contact import contact_in_words, speed_before
from applr_ros1.movers.tracker import Movers, MoverTracker
from applr_ros1.robots.geometry import radius
from applr_ros1.why.recording import Recording

TRACKED_S = 3.0  # time before a contact in which the tracker takes the scans [s]
# Largest gap between the robot's circumscribed circle and what touched it, by the last scan before
# the contact [m, for the Jackal]
GAP_M = 0.4
SIDES = ("ahead", "the left", "behind", "the right")  # quarters around the robot, from its front


class FirstContact(NamedTuple):
    """First contact of a drive.

    Attributes:
        time: Time of the contact [s].
        speed: Speed of the robot [m/s].
        mover_speed: Speed of what touched it [m/s]; 0 if nothing moved there.
        side: One of SIDES from which it came.
    """

    time: float
    speed: float
    mover_speed: float = 0.0
    side: str = ""

    def __str__(self) -> str:
        contact = f"At {self.time:.1f} s the robot {contact_in_words(self.speed)}"
        if self.mover_speed == 0.0:
            return f"{contact}."
        return f"{contact} by something that came from {self.side} at {self.mover_speed:.1f} m/s."


def touch_of(recording: Recording) -> Optional[FirstContact]:
    """Return the first contact of a recorded drive, or None without one.

    The robot's speed is the true one if it is known, else that of the odometry.
    """
    drive = recording.drive
    if not len(drive.contacts):
        return None
    time = float(drive.contacts[0])
    motion = drive.truth if drive.truth is not None else recording.odometry
    touch = FirstContact(time, speed_before(motion, time))

    # The moving obstacle that is nearest to the robot, if it is near enough
    movers = _movers_at(recording, time)
    if not len(movers.x):
        return touch
    x, y, yaw = recording.odometry.pose_at(time)
    gaps = np.hypot(movers.x - x, movers.y - y) - movers.radius - radius(recording.robot)
    nearest = int(gaps.argmin())
    if gaps[nearest] > GAP_M * recording.robot.world_scale:
        return touch
    vx = float(movers.vx[nearest])
    vy = float(movers.vy[nearest])
    bearing = normalize_angle(math.atan2(-vy, -vx) - yaw)
    quarter = round(bearing / (0.5 * math.pi)) % len(SIDES)
    return touch._replace(mover_speed=math.hypot(vx, vy), side=SIDES[quarter])


def _movers_at(recording: Recording, time: float) -> Movers:
    """Return the moving obstacles in the last scan before a time [s], at this time."""
    tracker = MoverTracker.of(recording.robot)
    stamps = recording.scans.stamp
    first_row = int(np.searchsorted(stamps, time - TRACKED_S))
    end_row = int(np.searchsorted(stamps, time))
    movers = tracker.movers
    for row in range(first_row, end_row):
        scan = replace(recording.scan(row), stamp=float(stamps[row]))
        movers = tracker.update(scan)
    interval = time - float(stamps[max(end_row - 1, 0)])
    return movers._replace(x=movers.x + interval * movers.vx, y=movers.y + interval * movers.vy)
