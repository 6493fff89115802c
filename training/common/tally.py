"""Counts by reason, of which there may be any number: refused trajectories, skipped episodes, failed trials."""

from __future__ import annotations

from typing import Dict

MOST = 50  # different reasons that are kept apart
OTHERS = "further reasons"


class Tally(Dict[str, int]):
    """{reason: how often}. Reasons beyond the first MOST are counted together, so that memory stays bounded."""

    def add(self, reason: str, count: int = 1) -> bool:
        """Count a reason; returns whether it is one that was not counted before."""
        key = reason if reason in self or len(self) < MOST else OTHERS
        new = key not in self
        self[key] = self.get(key, 0) + count
        return new

    @property
    def commonest(self) -> str:
        """The reason that was counted most often; "" where nothing was counted."""
        return max(self, key=self.__getitem__, default="")
