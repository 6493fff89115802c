"""Puts the planner back on theta_0 when the applr node has died: its last parameters would otherwise stay in force.

Called by the move_base node once per cycle. A planner that has never received a heartbeat is left alone.
"""

from __future__ import annotations

from typing import Any, Dict, Optional

from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.parameter_space import Space

LOST_PERIODS = 2.5  # heartbeats that stay away: theta_0 is back within three of them of the node's death


class HeartbeatWatchdog:
    """Says once when the heartbeats stop.

    Args:
        period: Longest time [s] between two heartbeats of a living applr node.
    """

    def __init__(self, period: float):
        self.patience = LOST_PERIODS * period
        self._last: Optional[float] = None

    def heartbeat(self, now: float) -> None:
        """Take a heartbeat of the applr node that arrived at `now` [s]."""
        self._last = now

    def is_lost(self, now: float) -> bool:
        """Return True once, LOST_PERIODS periods after the last heartbeat."""
        if self._last is None:
            return False
        if now < self._last:  # the clock went back
            self._last = now
        if now - self._last <= self.patience:
            return False
        self._last = None
        return True


def start_up_requests(move_base: MoveBase, space: Space, max_speed: float = 0.0) -> Dict[str, Dict[str, Any]]:
    """Return {server: {name: value}} that give the parameters of a space the values with which the planner started.

    max_speed: the largest forward speed [m/s] among them; 0 for any.
    """
    requests = {}
    for server in set(space.servers) & set(move_base.servers):
        start = move_base.start_up_configuration(server)
        values = {name: start[name] for name in space.requests(space.theta0)[server]}
        for name in set(values) & {"max_vel_x", "max_vel_trans"} if max_speed > 0.0 else ():
            values[name] = min(values[name], max_speed)
        requests[server] = values
    return requests
