"""The time of a search."""

from __future__ import annotations

import time
from typing import Iterable, Iterator, TypeVar

from training.trials.table import Trials

T = TypeVar("T")


class Clock:
    """Wall time of a search over all its sessions.

    A table keeps each look at the clock, so that a search that was stopped decides again as before and comes to where
    it was through the trials that it has driven.

    Args:
        table: keeps the looks.
        name: of the list in it.
        seconds: of the whole search.
    """

    def __init__(self, table: Trials, name: str, seconds: float):
        self._table, self._name, self._seconds = table, name, seconds
        self._looks = list(table.notes.get(name, []))
        self._again = iter(list(self._looks))
        self._began = time.monotonic() - (self._looks[-1] if self._looks else 0.0)

    def spent(self) -> float:
        """Return the share of the time that is over."""
        now = next(self._again, None)
        if now is None:
            now = time.monotonic() - self._began
            self._looks.append(now)
            self._table.note(**{self._name: self._looks})
        return now / self._seconds

    def until(self, share: float, blocks: Iterable[T], fewest: int = 1) -> Iterator[T]:
        """Yield those of the blocks that begin before so much is spent, at least the fewest."""
        for number, block in enumerate(blocks):
            if number >= fewest and self.spent() >= share:
                return
            yield block
