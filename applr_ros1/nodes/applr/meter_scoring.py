"""Finds out whether a running planner's distance biases count per metre or per cell, and rescales a set for it.

Held by the applr node, whose thread calls everything but the cloud's callback. policy/distance_weights.py says what it
is about and does the arithmetic.
"""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import PointCloud2

from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.policy.distance_weights import PLANNER, factor_of, indices_of, multipliers_of

AUTO, TRUE, FALSE = CHOICES = ("auto", "true", "false")  # of meter_scoring, C++'s own word
PATIENCE_S = 1.0  # of ROS time that a course's first decision waits for a cloud
ODD_CLOUDS = 20  # clouds that fit no kind of weights, after which the search is given up
FIELDS = ("x", "y", "z", "path", "goal", "occ", "total")  # what the names of a cost_cloud's fields begin with


class MeterScoring:
    """A watch on what the planner's distance biases count, which has the client rescale sets for it.

    Args:
        client: Of the planner's parameters.
        choice: AUTO: found from the cost_cloud of the first goal; TRUE, FALSE: as a person says, the biases are
            multiplied by the local costmap's resolution or not.
    """

    def __init__(self, client: ReconfigureClient, choice: str = AUTO):
        self.choice = choice
        self._client, self._space = client, client.space
        self._at = indices_of(client.space)  # None: a robot whose space has no distance biases
        self._subscriber: Optional[rospy.Subscriber] = None
        self.forget()

    def forget(self) -> None:
        """Know nothing, and send sets as they are: the planner was started anew. May be called from any thread."""
        self._client.multipliers = np.ones(len(self._space))
        self._factor: Optional[float] = None  # what the biases are multiplied by, once it is known
        self._odd = 0
        self._since: Optional[rospy.Time] = None  # when the node began to listen
        self._used: Tuple[Optional[float], bool] = (None, False)  # what the multipliers are for
        self._line = ""

    def look(self, now: rospy.Time, driving: bool, per_cell: bool) -> bool:
        """Listen while there is something to find, log what was found, and set the client's multipliers.

        Args:
            now: ROS time.
            driving: Whether there is a goal.
            per_cell: Whether the method's sets count per cell (policy.decision.Method.per_cell).

        Returns:
            Whether the multipliers have changed.
        """
        if self._at is not None and self.choice != AUTO and self._factor is None:
            self._factor = self._resolution() if self.choice == TRUE else 1.0
        wanted = self._at is not None and driving and self._factor is None and self._odd < ODD_CLOUDS
        if wanted and self._since is None:
            self._since = now
        if wanted and self._subscriber is None:
            self._subscriber = rospy.Subscriber(
                self._topic(), PointCloud2, self._on_cloud, queue_size=1, buff_size=2**24
            )
        elif not wanted and self._subscriber is not None:
            self._subscriber.unregister()
            self._subscriber = None
        before = self._client.multipliers
        if self._used != (self._factor, per_cell):
            self._used = self._factor, per_cell
            self._client.multipliers = self._multipliers(per_cell)
        line = self.line(now)
        if line not in ("", self._line):
            rospy.loginfo("applr: %s", line)
        self._line = line
        return not np.array_equal(before, self._client.multipliers)

    def waits(self, now: rospy.Time) -> bool:
        """Return whether a cloud that would tell may be about to come."""
        since = self._since
        listens = self._subscriber is not None and self._factor is None and since is not None
        return listens and (now - since).to_sec() < PATIENCE_S

    def line(self, now: rospy.Time) -> str:
        """Say what is known and done; "" before there was an occasion to find out."""
        factors = zip(self._space.names, self._client.multipliers)
        sent = ", ".join(f"{name} x {factor:.6g}" for name, factor in factors if factor != 1.0)
        why = sent and f"the set is made for weights per cell, so what is sent is {sent}"
        return "; ".join(filter(None, [self._known(now), why]))

    def _known(self, now: rospy.Time) -> str:
        if self._at is None:
            return f"sets are sent as they are: only the distance weights of {PLANNER} are rescaled"
        if self._factor is not None:
            how = "found from cost_cloud" if self.choice == AUTO else f"as said by meter_scoring:={self.choice}"
            return f"the planner's distance weights count per {'cell' if self._factor == 1.0 else 'metre'} ({how})"
        why = "" if self._since is None else f"no cost_cloud on {self._topic()}"
        if self._odd >= ODD_CLOUDS:
            why = f"the cost_cloud on {self._topic()} fits neither kind"
        if not why or (self.waits(now) and self._odd < ODD_CLOUDS):
            return ""
        return "the planner's distance weights are taken to be what the set was made for: " + why

    def _multipliers(self, per_cell: bool) -> np.ndarray:
        nothing = np.ones(len(self._space))
        if self._factor is None or self._at is None or not per_cell:
            return nothing
        low, high = self._client.bounds()
        found = multipliers_of(self._space, self._factor, high[self._at[:2]].min())
        if (found * self._space.low >= low).all() and (found * self._space.high <= high).all():
            return found
        rospy.logwarn("applr: the distance biases are not rescaled: the planner's bounds do not allow it")
        return nothing

    def _topic(self) -> str:
        return self._client.servers[PLANNER] + "/cost_cloud"

    def _resolution(self) -> float:
        """Return the local costmap's resolution [m], as the parameter server has it."""
        value = rospy.get_param(self._client.namespace + "/local_costmap/resolution", 0.05)
        return float(value) if isinstance(value, (int, float)) and value > 0.0 else 0.05

    def _on_cloud(self, message: PointCloud2) -> None:
        rows, values = rows_of(message), self._client.values()
        if values is None or self._at is None:
            return
        factor = None if rows is None else factor_of(rows, values[self._at], self._resolution())
        if factor is None:
            self._odd += 1
        elif self._factor is None:
            self._factor = factor


def rows_of(message: PointCloud2) -> Optional[np.ndarray]:
    """Return the rows (n, 7) of a cost_cloud; None where the message is not one."""
    step, fields = message.point_step, message.fields
    named = len(fields) == len(FIELDS) and all(f.name.startswith(name) for f, name in zip(fields, FIELDS))
    if not named or step != 4 * len(FIELDS) or len(message.data) % step or any(f.datatype != 7 for f in fields):
        return None
    return np.frombuffer(message.data, ">f4" if message.is_bigendian else "<f4").reshape(-1, len(FIELDS))
