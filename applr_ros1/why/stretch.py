"""Stretch of a drive in which somebody asks why the robot did not drive, and how it is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Optional, Sequence, TypeVar

import numpy as np

from applr_ros1.drives.drive import Drive, Rows

SomeRows = TypeVar("SomeRows", bound=Rows)
SLOW = 0.6  # share of the top speed below which a robot is slow


@dataclass(frozen=True)
class Stretch:
    """Part of a drive in which the robot did not drive as it should.

    Attributes:
        drive: The drive.
        begin: Begin [s].
        end: End [s].
        share: Share of the stretch from which on an observation is its reason.
        period: Control period of the planner [s]; 0 if it is unknown.
    """

    drive: Drive
    begin: float
    end: float
    share: float
    period: float = 0.0

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return self.end - self.begin

    def part(self, rows: Optional[SomeRows]) -> Optional[SomeRows]:
        """Return the rows of the stretch, or None if there are none."""
        if rows is None:
            return None
        rows_of_stretch = rows.between(self.begin, self.end)
        return rows_of_stretch if len(rows_of_stretch) else None

    def in_force(self, rows: Optional[SomeRows]) -> Optional[SomeRows]:
        """Return the rows of which each holds until the next one, from the begin of the stretch on.

        None if there are none. The row before the stretch, which holds at its begin, is the first.
        """
        if rows is None:
            return None
        first_row = max(rows.latest(self.begin), 0)
        end_row = rows.latest(self.end) + 1
        if end_row <= first_row:
            return None
        held_rows = rows.part(slice(first_row, end_row))
        return replace(held_rows, time=np.maximum(held_rows.time, self.begin))

    def is_reason(self, seconds: float) -> bool:
        """Return whether an observation that holds for this time [s] counts as the reason."""
        return self.seconds > 0.0 and seconds > self.share * self.seconds


Finder = Callable[[Stretch], str]  # Returns a reason in words, or "".


def first_of(finders: Sequence[Finder], stretch: Stretch) -> str:
    """Return the words of the first finder that has some, or ""."""
    for find in finders:
        reason_in_words = find(stretch)
        if reason_in_words:
            return reason_in_words
    return ""


def latest_rows(rows: Rows, times: np.ndarray) -> np.ndarray:
    """Return the indices of the latest rows at some times (n,) [s]; 0 before the first row."""
    rows_until = [rows.latest(time) for time in times]
    return np.maximum(rows_until, 0)


def durations(rows: Rows, end: float) -> np.ndarray:
    """Return how long each row holds [s]: until the next one, the last one until `end`."""
    seconds: np.ndarray = np.diff(rows.time, append=end)
    return seconds
