"""Puts the planner back on theta_0 when the applr node has died: the node is gone, its last parameters are not.

Called by the move_base node once per cycle. A planner that never heard a heartbeat is left alone.
"""

from __future__ import annotations

from typing import Dict

from applr_ros1.policy.parameter_space import SPACE

SERVERS = {
    "planner": "TrajectoryPlannerROS",
    "local_inflation": "local_costmap/inflater_layer",
    "global_inflation": "global_costmap/inflater_layer",
}
PERIODS = 2.5  # without a heartbeat: back on theta_0 within three periods of the node's death


class Guard:
    """`period`: seconds between the applr node's decisions, each of which comes with a heartbeat."""

    def __init__(self, period: float):
        self.patience = PERIODS * period
        self._heard = None

    def heartbeat(self, now: float) -> None:
        """The applr node is alive at `now` [s]."""
        self._heard = now

    def is_lost(self, now: float) -> bool:
        """True once, PERIODS periods after the last heartbeat."""
        if self._heard is None:
            return False
        if now < self._heard:  # the clock went back
            self._heard = now
        if now - self._heard <= self.patience:
            return False
        self._heard = None
        return True


def start_up_requests(start_up_configuration) -> Dict[str, Dict[str, object]]:
    """For each server what makes the eight parameters those of start-up. Argument: server name -> its values."""
    requests: Dict[str, Dict[str, object]] = {}
    for targets in SPACE.targets.values():
        for target in targets:
            server = SERVERS[target.server]
            values = start_up_configuration(server)
            name = next(name for name in target.names if name in values)
            requests.setdefault(server, {})[name] = values[name]
    return requests
