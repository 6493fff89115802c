"""Clocks that go back: a bag that is played in a loop, a simulator that is reset, a wall clock that is set."""

import rospy
from rospy.rostime import is_wallclock

ADJUSTMENT = 1.0  # s by which a wall clock may be set back without counting as a jump (NTP does this)


def jumped_back(last: rospy.Time, now: rospy.Time) -> bool:
    """Whether ROS time has jumped back since `last`: a simulated clock at all, a wall clock by more than ADJUSTMENT."""
    return now < last and (not is_wallclock() or (last - now).to_sec() > ADJUSTMENT)
