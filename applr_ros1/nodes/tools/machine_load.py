"""Effects of a busy machine on a drive of the demo: skipped control cycles and late decisions.

move_base and the applr node count them in their diagnostics, once per second.
"""

from __future__ import annotations

from typing import Any, Dict, Set

from applr_ros1.nodes.move_base.reports import SKIPPED

# Counters in /diagnostics: decisions of the applr node, and late ones
DECISIONS = "decisions"
LATE = "late"
SPOILED_SHARE = 0.1  # share of cycles or decisions from which on a drive says little


class MachineLoad:
    """Counts of a drive, from the first reports after `begin` to the latest ones."""

    def __init__(self) -> None:
        self._totals: Dict[str, int] = {}
        self._begin_totals: Dict[str, int] = {}
        self._reported: Set[str] = set()  # counters reported since `expect_reports`

    def expect_reports(self) -> None:
        """Wait for new reports, until `is_reported`."""
        self._reported.clear()

    @property
    def is_reported(self) -> bool:
        """True if both nodes have reported since `expect_reports`."""
        return {SKIPPED, LATE} <= self._reported

    def read_diagnostics(self, message: Any) -> None:
        """Take a diagnostic_msgs/DiagnosticArray of any node."""
        for status in message.status:
            for pair in status.values:
                if pair.key in (SKIPPED, DECISIONS, LATE):
                    self._totals[pair.key] = int(pair.value)
                    self._reported.add(pair.key)

    def begin(self) -> None:
        """Begin to count."""
        self._begin_totals = dict(self._totals)

    def count(self, counter: str) -> int:
        """Return a counter's increase since `begin`."""
        return self._totals.get(counter, 0) - self._begin_totals.get(counter, 0)

    def sentence(self, cycles: float) -> str:
        """Return in a sentence what a busy machine has spoiled, or "" if it does not matter.

        cycles: number of control cycles that the drive should have had.
        """
        skipped = self.count(SKIPPED)
        late = self.count(LATE)
        decisions = self.count(DECISIONS)
        problems = []
        if skipped >= SPOILED_SHARE * cycles and skipped:
            problems.append(f"move_base skipped {skipped} of {cycles:.0f} cycles")
        if late >= SPOILED_SHARE * decisions and late:
            problems.append(f"{late} of {decisions} decisions were late")
        if not problems:
            return ""
        remedy = "end other programs, or give real_time_factor:=0.5"
        return f"this machine was too busy: {' and '.join(problems)}; {remedy}"
