"""Puts the planner back on theta_0 when the applr node has died: its last parameters would otherwise stay in force.

Called by the move_base node once per cycle. A planner that has never received a heartbeat is left alone.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional, Sequence

from applr_ros1.policy.parameter_space import SPACE, Space

PERIODS = 2.5  # heartbeats that stay away: theta_0 is back within three of them of the node's death


class HeartbeatWatchdog:
    """Says once when the heartbeats stop.

    Args:
        period: Longest time [s] between two heartbeats of a living applr node.
    """

    def __init__(self, period: float):
        self.patience = PERIODS * period
        self._last: Optional[float] = None

    def heartbeat(self, now: float) -> None:
        """A heartbeat of the applr node arrived at `now` [s]."""
        self._last = now

    def is_lost(self, now: float) -> bool:
        """True once, PERIODS periods after the last heartbeat."""
        if self._last is None:
            return False
        if now < self._last:  # the clock went back
            self._last = now
        if now - self._last <= self.patience:
            return False
        self._last = None
        return True


def start_up_requests(
    start_up_configuration: Callable[[str], Dict[str, Any]],
    servers: Sequence[str],
    space: Space = SPACE,
    max_speed: float = 0.0,
) -> Dict[str, Dict[str, Any]]:
    """What each server has to be sent to give the learned parameters their values of the node's start.

    Args:
        start_up_configuration: Maps a server's name to its values {name: value} at the start.
        servers: The names of the servers that there are; what others would have to be sent is left out.
        space: The parameters that are learned.
        max_speed: Largest forward speed [m/s] among them; 0 for any.

    Returns:
        {server: {name: value}}.
    """
    wanted = {server: names for server, names in space.requests(space.theta0).items() if server in servers}
    start_up = {server: start_up_configuration(server) for server in wanted}
    requests = {server: {name: start_up[server][name] for name in names} for server, names in wanted.items()}
    for values in requests.values():
        for name in set(values) & {"max_vel_x", "max_vel_trans"} if max_speed > 0.0 else ():
            values[name] = min(values[name], max_speed)
    return requests
