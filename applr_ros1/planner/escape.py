"""Escape motions: a sequence of short motions for a robot that its collision monitor blocks.

C++ has no collision monitor. Its local planner backs out whenever it finds no legal trajectory, regardless of
obstacles behind the robot, and samples no forward velocity until it has backed out. If a monitor blocked the way back,
the robot would stand there forever. If the monitor stops the robot closer to an obstacle than the planner's footprint
allows, the planner finds no command at all.

The state machine asks an Escape for a motion in each cycle, and gets none without reports of a monitor or with planner
fidelity "cpp-like". With a C++ move_base, the monitor itself runs an Escape (monitor/stalled_planner.py).
"""

from __future__ import annotations

from typing import Optional, Tuple

HELD = 0.5  # time for which the monitor blocks the planner's commands before an escape motion [s]
BLOCKED = 2.0  # time for which the planner finds no command before an escape motion [s]
TRIED = 0.15  # time after which a blocked escape motion gives way to the next one [s]
MOVED = 0.5  # duration of an escape motion that is not blocked [s]
PASSED = 1.0  # time of unblocked planner commands after which the robot counts as free [s]
TRIES = 24  # number of unsuccessful escape motions after which a recovery is due
V, W = 0.1, 0.4  # speed and turn rate of the escape motions [m/s, rad/s]
MOTIONS = ((0.0, W), (0.0, -W), (-V, W), (-V, -W), (V, W), (V, -W), (V, 0.0), (-V, 0.0))


class Escape:
    """Sequence of escape motions. They ignore the costmap, because the collision monitor decides what is safe."""

    def __init__(self) -> None:
        self._held: Optional[bool] = None  # latest report of the monitor, None if there is none
        self._next = 0  # index of the next motion
        self.is_held = (
            False  # True from the first escape motion until the robot counts as free (PASSED)
        )
        self.restart()

    def restart(self) -> None:
        """Reset timers and counters after a recovery."""
        self._since: Optional[float] = None  # start of the blockage [s]
        self._free_since: Optional[float] = None  # start of unblocked planner commands [s]
        self._motion: Optional[Tuple[float, float]] = None  # motion under way
        self._began = 0.0
        self._tries = 0

    def give_way(self) -> None:
        """End the motion under way because the planner has found a command again."""
        self._motion = self._since = None

    def report(self, held: bool) -> None:
        """Record whether the monitor blocked nearly all of the last command."""
        self._held = bool(held)

    @property
    def is_exhausted(self) -> bool:
        """True if TRIES motions were unsuccessful and a recovery is due."""
        return self._tries >= TRIES

    def instead(self, now: float, blocked: bool) -> Optional[Tuple[float, float]]:
        """Return the escape motion (v [m/s], w [rad/s]) at time `now` [s], or None to use the planner's command.

        Args:
            now: time [s].
            blocked: whether the planner found no command.
        """
        if self._held is None:
            return None
        if self._motion is not None:
            if self._held and now - self._began >= TRIED:
                self._begin(now)
            elif now - self._began >= MOVED:
                self._motion = self._since = None
        elif not self._held and not blocked:
            self._since = None
            self._free_since = now if self._free_since is None else self._free_since
            if now - self._free_since >= PASSED:
                self._tries, self.is_held = 0, False
        else:
            self._free_since = None
            self._since = now if self._since is None else self._since
            if now - self._since >= (HELD if self._held else BLOCKED):
                self._begin(now)
        return self._motion

    def _begin(self, now: float) -> None:
        self._motion, self._began = MOTIONS[self._next % len(MOTIONS)], now
        self._next += 1
        self._tries += 1
        self.is_held = True
