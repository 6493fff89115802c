"""Contacts of a drive: how fast the robot was when it was touched, and the same in words.

A robot that stands when somebody walks into it has done what it can. Outcomes, pages, the demo and
`why` therefore tell a contact at rest from one in motion.
"""

import math

from applr_ros1.drives.drive import Drive, Motion

# Speed above which a robot that is touched counts as moving in tables [m/s]; the monitor lets it
# creep into unobserved space at this speed.
MOVING_M_S = 0.1
STOOD_M_S = 0.05  # speed below which it stood, in words [m/s]


def contact_speed(drive: Drive, begin: float = 0.0) -> float:
    """Return how fast the robot truly drove when it was first touched [m/s].

    NaN if nothing touched it, or if its true motion or the time of the contact is unknown.

    Args:
        drive: Drive with contacts.
        begin: Time up to which contacts belong to an earlier course [s].
    """
    contact_times = drive.contacts[drive.contacts > begin]
    if drive.truth is None or not len(contact_times) or not math.isfinite(contact_times[0]):
        return math.nan
    return speed_before(drive.truth, contact_times[0])


def speed_before(motion: Motion, time: float) -> float:
    """Return the magnitude of the forward speed [m/s] before a contact at a time [s]."""
    # The contact itself changes the speed, so that of the row before counts.
    row = max(motion.latest(time) - 1, 0)
    v, _ = motion.twist[row]
    return abs(float(v))


def contact_in_words(speed: float) -> str:
    """Return a contact of a robot at a speed [m/s] in words; NaN if the speed is unknown."""
    if math.isnan(speed):
        return "touched something"
    if speed < STOOD_M_S:
        return "stood when touched"
    return f"was touched at {speed:.1f} m/s"
