"""When a part of move_base that has its own frequency is due, on a clock that is passed in."""

from __future__ import annotations

import math

EARLY = 0.2  # of a period: a step that comes this much early still counts, so that jitter skips no turn


class Timer:
    """Keeps its phase while it is asked often enough; a late turn is not repeated. 0 Hz is never due."""

    __slots__ = ("_period", "_next")

    def __init__(self):
        self._period, self._next = math.inf, -math.inf

    def set_frequency(self, frequency: float) -> None:
        """Take a new frequency [Hz]; the same again changes nothing, another one is due at once."""
        period = 1.0 / frequency if frequency > 0.0 else math.inf
        if period != self._period:
            self._period, self._next = period, -math.inf

    def due(self, now: float) -> bool:
        """Whether the turn is to be taken now; taking it starts the next period."""
        period = self._period
        if period == math.inf:
            return False
        wait = self._next - now
        if EARLY * period < wait <= period * (1.0 + EARLY):
            return False
        # a turn missed, the first turn, or a clock that went back: start anew from here
        self._next = now + period if not -period < wait <= EARLY * period else self._next + period
        return True

    def restart(self, now: float) -> None:
        """The next turn is due one period from now."""
        self._next = now + self._period
