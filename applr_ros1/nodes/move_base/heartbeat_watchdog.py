"""Watchdog that restores the start-up parameters after the applr node has died.

Without it, the last parameters of the dead node would stay in force. The move_base node calls the
watchdog once per cycle. Until the first heartbeat, the watchdog does nothing.
"""

from __future__ import annotations

from typing import Dict, Optional

from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.planner.parameters.trees import Tree
from applr_ros1.policy.parameter_space import Space

# Number of periods without a heartbeat after which the applr node counts as dead
LOST_PERIODS = 2.5


class HeartbeatWatchdog:
    """Detects that the heartbeats have stopped, and reports this once.

    Args:
        period: Longest time between two heartbeats of a running applr node [s].
    """

    def __init__(self, period: float):
        self.patience = LOST_PERIODS * period
        self._last: Optional[float] = None

    def heartbeat(self, now: float) -> None:
        """Note a heartbeat of the applr node that arrived at `now` [s]."""
        self._last = now

    def is_lost(self, now: float) -> bool:
        """Return True once, LOST_PERIODS periods after the last heartbeat."""
        if self._last is None:
            return False
        if now < self._last:  # The clock jumped back.
            self._last = now
        if now - self._last <= self.patience:
            return False
        self._last = None
        return True


def start_up_settings(move_base: MoveBase, space: Space) -> Settings:
    """Return the settings that restore a space's parameters to the planner's start-up values.

    These may exceed max_speed: the last guard then slows the commands (MoveBaseNode).

    Args:
        move_base: The MoveBase.
        space: Space of the parameters.
    """
    start_values: Dict[str, Tree] = {}
    for _, target in space.addresses:
        # The policy may also learn parameters of a planner that is not in use.
        if target.server in move_base.start_up:
            value = move_base.start_up[target.server][target.name]
            start_values.setdefault(target.server, {})[target.name] = value
    return Settings(start_values)
