"""Small motions, one after the other, of a robot with a collision monitor that is stuck.

C++ knows no monitor. Its local planner backs out whenever it finds no legal trajectory, whatever stands behind, and
samples no forward velocity before it has come out; with a monitor before the base the robot would stand there for
ever. And where the monitor stops the robot nearer to an obstacle than the planner's footprint allows, the planner finds
no command at all. The state machine asks an Escape in each control cycle; without a monitor that reports, and with
planner "cpp-like", it never does anything. Beside a C++ move_base the monitor asks one (monitor/stalled_planner.py).
"""

from __future__ import annotations

from typing import Optional, Tuple

HELD = 0.5  # s for which the planner's commands are held back before something else is tried
BLOCKED = 2.0  # s for which the planner finds no command before something else is tried
TRIED = 0.15  # s after which a motion that is held back, too, gives way to the next one
MOVED = 0.5  # s of a motion that comes through; then the planner chooses again
PASSED = 1.0  # s of the planner's own commands coming through, after which the robot counts as free
TRIES = 24  # motions without getting free, after which a recovery is due
V, W = 0.1, 0.4  # m/s, rad/s
MOTIONS = ((0.0, W), (0.0, -W), (-V, W), (-V, -W), (V, W), (V, -W), (V, 0.0), (-V, 0.0))


class Escape:
    """Small motions, none of which looks at the costmap: what may be driven is for the monitor to say."""

    def __init__(self):
        self._held: Optional[bool] = None  # the newest word of the monitor; None: there is none
        self._next = 0  # index of the next motion
        self.is_held = False  # whether the robot has not got free since it was first held back
        self.restart()

    def restart(self) -> None:
        """Begin to count anew: a recovery has been made."""
        self._since: Optional[float] = None  # since when the planner's commands are held back
        self._free_since: Optional[float] = None  # since when they come through
        self._motion: Optional[Tuple[float, float]] = None  # under way
        self._began = 0.0
        self._tries = 0

    def give_way(self) -> None:
        """End the motion under way: the planner, which had no command, has one."""
        self._motion = self._since = None

    def report(self, held: bool) -> None:
        """Note if next to nothing of the last command came through."""
        self._held = bool(held)

    @property
    def is_exhausted(self) -> bool:
        """True if so many motions did not help that a recovery is due."""
        return self._tries >= TRIES

    def instead(self, now: float, blocked: bool) -> Optional[Tuple[float, float]]:
        """The motion (v [m/s], w [rad/s]) to be driven at `now` [s]; None for the planner's own command.

        blocked: the planner has found none.
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
