"""Time budget of a search."""

from __future__ import annotations

import time
from typing import Iterable, Iterator, List, TypeVar

from training.evaluate.table import TrialTable

T = TypeVar("T")


class SearchClock:
    """Wall time of a search over all its sessions.

    The table of trials stores each reading. A continued search therefore repeats its decisions,
    finds its trials in the table, and goes on from where it was stopped.

    Args:
        table: Table that stores the readings.
        name: Name of the readings in the table.
        seconds: Time budget of the whole search [s].
    """

    def __init__(self, table: TrialTable, name: str, seconds: float):
        self._table = table
        self._name = name
        self._seconds = seconds
        self._asked = 0  # number of readings that this session has asked for
        self._readings: List[float] = list(table.notes.get(name, []))
        # The time between two sessions does not count.
        self._began = time.monotonic() - max(self._readings, default=0.0)

    def spent(self) -> float:
        """Return the share of the time that has passed."""
        self._asked += 1
        if self._asked > len(self._readings):
            self._readings.append(time.monotonic() - self._began)
            self._table.note(**{self._name: self._readings})
        return self._readings[self._asked - 1] / self._seconds

    def until(self, share: float, blocks: Iterable[T]) -> Iterator[T]:
        """Yield blocks, at least one, until this share of the time has passed."""
        for number, block in enumerate(blocks):
            if number and self.spent() >= share:
                return
            yield block
