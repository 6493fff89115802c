"""Puts the planner back on theta_0 when the applr node has died: its last parameters would otherwise stay in force.

Called by the move_base node once per cycle. A planner that has never received a heartbeat is left alone.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional, Sequence

from applr_ros1.policy.parameter_space import SPACE

SERVERS = {
    "planner": "TrajectoryPlannerROS",
    "local_inflation": "local_costmap/inflater_layer",
    "global_inflation": "global_costmap/inflater_layer",
}
PERIODS = 2.5  # decision periods without a heartbeat: theta_0 is back within three periods of the node's death


class HeartbeatWatchdog:
    """Says once when the heartbeats stop.

    Args:
        period: Time [s] between two decisions of the applr node, each of which comes with a heartbeat.
    """

    def __init__(self, period: float):
        self.patience = PERIODS * period
        self._last: Optional[float] = None

    def heartbeat(self, now: float) -> None:
        """A heartbeat of the applr node arrived at `now` [s]."""
        self._last = now

    def is_lost(self, now: float) -> bool:
        """True once, PERIODS decision periods after the last heartbeat."""
        if self._last is None:
            return False
        if now < self._last:  # the clock went back
            self._last = now
        if now - self._last <= self.patience:
            return False
        self._last = None
        return True


def start_up_requests(
    start_up_configuration: Callable[[str], Dict[str, Any]], servers: Sequence[str] = tuple(SERVERS.values())
) -> Dict[str, Dict[str, Any]]:
    """What each server has to be sent to give the eight learned parameters their values of the node's start.

    Args:
        start_up_configuration: Maps a server's name to its values {name: value} at the start.
        servers: The names of the servers that there are; what others would have to be sent is left out.

    Returns:
        {server: {name: value}}.
    """
    requests: Dict[str, Dict[str, Any]] = {}
    for targets in SPACE.targets.values():
        for target in targets:
            server = SERVERS[target.server]
            if server not in servers:
                continue
            values = start_up_configuration(server)
            name = next(name for name in target.names if name in values)
            requests.setdefault(server, {})[name] = values[name]
    return requests
