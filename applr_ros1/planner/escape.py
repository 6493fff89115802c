"""Escape motions: a sequence of short motions for a robot that its collision monitor blocks.

C++ has no collision monitor. Its local planner backs out whenever it finds no legal trajectory,
regardless of obstacles behind the robot, and samples no forward velocity until it has backed out.
If a monitor blocked the way back, the robot would stand there forever. If the monitor stops the
robot closer to an obstacle than the planner's footprint allows, the planner finds no command at
all.

The state machine asks an Escape for a motion in each cycle, and gets none without reports of a
monitor or with planner fidelity "cpp-like". With a C++ move_base, the monitor itself runs an Escape
(stack/command_chain.py).
"""

from __future__ import annotations

from typing import Optional

from applr_ros1.common.angles import Twist

HELD = 0.5  # time for which the monitor blocks the planner's commands before a motion [s]
BLOCKED = 2.0  # time for which the planner finds no command before a motion [s]
TRIED = 0.15  # time after which a blocked motion gives way to the next one [s]
MOVED = 0.5  # duration of a motion that is not blocked [s]
PASSED = 1.0  # time of unblocked planner commands after which the robot counts as free [s]
TRIES = 24  # number of the motion, the last one of the third round, that a recovery replaces
V = 0.1  # speed of the motions [m/s]
W = 0.4  # turn rate of the motions [rad/s]
# Turning comes first, because it needs the least room; curves come before straight ways.
MOTIONS = (
    (0.0, W),
    (0.0, -W),
    (-V, W),
    (-V, -W),
    (V, W),
    (V, -W),
    (V, 0.0),
    (-V, 0.0),
)


class Escape:
    """Sequence of escape motions.

    They ignore the costmap, because the collision monitor decides what is safe.

    Attributes:
        is_held: True from the first escape motion until the robot counts as free (PASSED).
    """

    def __init__(self) -> None:
        self._held: Optional[bool] = None  # latest report of the monitor, None if there is none
        # Number of the next motion. `restart` keeps it: a new blockage does not begin with the
        # motion that was tried last.
        self._motion_number = 0
        self.is_held = False
        self.restart()

    def restart(self) -> None:
        """Reset timers and counters after a recovery."""
        self._since: Optional[float] = None  # start of the blockage [s]
        self._free_since: Optional[float] = None  # start of unblocked planner commands [s]
        self._motion: Optional[Twist] = None  # motion under way
        self._began = 0.0
        self._tries = 0

    def give_way(self) -> None:
        """End the motion under way because the planner has found a command again."""
        self._motion = None
        self._since = None

    def report(self, held: bool) -> None:
        """Record whether the monitor blocked nearly all of the last command."""
        self._held = bool(held)

    @property
    def is_exhausted(self) -> bool:
        """True if a recovery is due in place of another motion."""
        return self._tries >= TRIES

    def motion(self, now: float, blocked: bool) -> Optional[Twist]:
        """Return the escape motion to use instead of the planner's command, or None.

        Args:
            now: time [s].
            blocked: whether the planner found no command.

        Returns:
            (v [m/s], w [rad/s]).
        """
        # Without a monitor, nothing would keep the motions from hitting an obstacle.
        if self._held is None:
            return None
        if self._motion is not None:
            self._continue(now)
        elif not self._held and not blocked:
            self._record_free(now)
        else:
            self._record_blocked(now)
        return self._motion

    def _continue(self, now: float) -> None:
        """End or replace the motion under way if it has lasted long enough."""
        duration = now - self._began
        # A motion that moves the robot may open a way, so the planner then chooses again.
        if self._held and duration >= TRIED:
            self._begin(now)
        elif duration >= MOVED:
            self.give_way()

    def _record_free(self, now: float) -> None:
        """Count the robot as free if the planner's commands have passed for long enough."""
        self._since = None
        if self._free_since is None:
            self._free_since = now
        # One command that passes proves little: the next one may be blocked by the same obstacle.
        if now - self._free_since >= PASSED:
            self._tries = 0
            self.is_held = False

    def _record_blocked(self, now: float) -> None:
        """Begin a motion if the blockage has lasted long enough."""
        self._free_since = None
        if self._since is None:
            self._since = now
        # A planner without a command plans anew and may thus find one by itself.
        patience = HELD if self._held else BLOCKED
        if now - self._since >= patience:
            self._begin(now)

    def _begin(self, now: float) -> None:
        self._motion = MOTIONS[self._motion_number % len(MOTIONS)]
        self._began = now
        self._motion_number += 1
        self._tries += 1
        self.is_held = True
