"""How old scan, pose and twist are at each command of a node, for /diagnostics: what sensors and network cost."""

from __future__ import annotations

from collections import deque
from typing import Deque, Dict, Mapping

import numpy as np

COMMANDS = 600  # that the figures are of: half a minute at 20 Hz


class Ages:
    """The ages [s] of scan, pose and twist at the newest commands."""

    def __init__(self) -> None:
        self._known: Dict[str, Deque[float]] = {}

    def add(self, ages: Mapping[str, float]) -> None:
        """A command was made from what is {name: age [s]} old (Sensors.ages)."""
        for name, age in ages.items():
            self._known.setdefault(name, deque(maxlen=COMMANDS)).append(age)

    def values(self) -> Dict[str, str]:
        """{"scan_age_s": "median .., 99 % .., largest .."}, as /diagnostics shows it."""
        shown = {}
        for name, ages in self._known.items():
            median, most = np.percentile(ages, (50, 99))
            shown[name + "_age_s"] = f"median {median:.3f}, 99 % {most:.3f}, largest {max(ages):.3f}"
        return shown
