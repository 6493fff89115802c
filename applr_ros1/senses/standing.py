"""Thresholds at which a robot stands, a source is silent, a message too old, and a goal under way.

Two rows differ only with a reason. Thresholds of C++'s planners are parameters of the planner, and
those of a rule with its own measure (policy/stuck.py, movers/tracks.py) stand there.
"""

from typing import NamedTuple


class Rest(NamedTuple):
    """Speed v [m/s] and turn rate w [rad/s] below which a base stands."""

    v: float
    w: float

    def holds(self, v: float, w: float) -> bool:
        """Return whether a base with these velocities stands."""
        return abs(v) < self.v and abs(w) < self.w


# -- a robot stands --------------------------------------------------------------------------------
# By its odometry, which may be noisy at rest
STANDS = Rest(0.02, 0.05)
# Before another publisher may drive it: nothing must be left of the last motion.
HANDED_OVER = Rest(0.01, 0.02)
# In a recording: what creeps more slowly than this makes no way that an owner would see.
STOOD = Rest(0.03, 0.1)

# -- a source is silent ----------------------------------------------------------------------------
SILENT_S = 1.0  # a sensor or a transform that comes several times a second [s]
# A topic on a page: the slowest of them come once a second [s].
SILENT_ON_PAGE_S = 3.0
# A status of move_base, which comes five times a second [s]: an escape motion needs a recent goal.
STATUS_AGE_S = 1.0
# The same, until the course of a method ends: a new course would begin with the defaults [s].
STATUS_LOST_S = 2.0
# Odometry of a base that a measurement drives without a monitor [s]
SILENT_WHILE_BRAKING_S = 0.5

# -- a message is too old --------------------------------------------------------------------------
USABLE_AGE_S = 1.0  # scan, pose or plan of a decision, and largest lead of a stamp [s]
# Pose with which the collision monitor judges a command [s]
JUDGED_AGE_S = 0.3

# -- a goal is under way ---------------------------------------------------------------------------
# Codes of actionlib_msgs/GoalStatus
PENDING = 0
ACTIVE = 1
PREEMPTING = 6
PURSUED = (ACTIVE, PREEMPTING)  # move_base drives to it
UNDER_WAY = (PENDING, *PURSUED)  # It has not ended.
