"""Finds out whether a running planner's distance biases count per metre or per cell, and rescales a set for it.

In C++, TrajectoryPlannerROS reads `meter_scoring` from memory that nobody sets: the same robot may multiply
path_distance_bias and goal_distance_bias by the costmap's resolution (they count per metre) or not (per cell), and
drives differently. Every policy and set learned here is for a planner that counts per cell.
"""

from __future__ import annotations

import math
from typing import List, Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import PointCloud2

from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.nodes.conversions import COST_FIELDS
from applr_ros1.policy.parameter_space import Space
from applr_ros1.robots.learned import TRAJECTORY

PLANNER = TRAJECTORY  # DWAPlannerROS always counts per metre
# what meter_scoring multiplies, and the third weight of a trajectory's cost, which it leaves alone
WEIGHTS = ("path_distance_bias", "goal_distance_bias", "occdist_scale")
CLOSE = 0.002  # relative error of a cell's cost that a factor explains; float32 gives 1e-6
FEWEST = 20  # number of cells that an answer needs
AUTO, TRUE, FALSE = CHOICES = ("auto", "true", "false")  # of meter_scoring, C++'s own word
PATIENCE_S = 1.0  # ROS time that a course's first decision waits for a cloud [s]
ODD_CLOUDS = 20  # number of clouds that fit no kind of weights, after which the search is given up


def indices_of(space: Space) -> Optional[List[int]]:
    """Return the indices in theta of the three WEIGHTS; None if a space does not set them all."""
    found = {name: i for i, target in space.targets_of(PLANNER) for name in target.names}
    return [found[name] for name in WEIGHTS] if set(WEIGHTS) <= set(found) else None


def factor_of(rows: np.ndarray, weights: np.ndarray, resolution: float) -> Optional[float]:
    """Find by what the planner multiplies its two biases: 1.0 (per cell), or the resolution [m] (per metre).

    Args:
        rows: (n, 7) x, y, z [m], path, goal, obstacle and total cost of cells (cost_cloud). Rows of zeros, with which
            C++ fills its clouds up, are left out.
        weights: (3,) values in force of WEIGHTS.
        resolution: Of the local costmap.

    Returns:
        None if not exactly one of the two gives every cell's total cost: for instance if the biases have just been
        changed, or if there are too few cells.
    """
    rows = np.asarray(rows, dtype=np.float64)
    rows = rows[np.isfinite(rows).all(axis=1) & (rows[:, 6] > 0.0)]
    if len(rows) < FEWEST:
        return None
    path, goal, occ = weights
    distances, obstacles, total = path * rows[:, 3] + goal * rows[:, 4], occ * rows[:, 5], rows[:, 6]
    fitting = [
        factor
        for factor in (1.0, resolution)
        if (np.abs(factor * distances + obstacles - total) <= CLOSE * total).all()
    ]
    return fitting[0] if len(fitting) == 1 else None


def multipliers_of(space: Space, factor: float, largest: float = 5.0) -> np.ndarray:
    """Return by what (n,) a set that counts per cell is multiplied on its way to a planner, which then drives the same.

    A choice among trajectories stays the same when all three weights of their costs are multiplied alike. Biases beyond
    their bound are therefore sent, together with occdist_scale, as a half, a quarter ... of what they should be.

    Args:
        space: The parameters; of one that does not set all three weights none is changed.
        factor: By what the planner multiplies its two biases, 1.0 or the resolution of the local costmap [m].
        largest: The upper bound of the planner's biases.
    """
    found, indices = np.ones(len(space)), indices_of(space)
    if factor != 1.0 and indices is not None:
        path, goal, occ = indices
        wanted = 1.0 / factor
        excess = wanted * max(space.high[path], space.high[goal]) / largest
        found[occ] = 0.5 ** max(0, math.ceil(math.log2(excess)))
        found[[path, goal]] = wanted * found[occ]
    return found


class MeterScoring:
    """Watches what the planner's distance biases count, and has the client rescale sets for it.

    The applr node's thread calls everything but the cloud's callback.

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
            if self._factor is None or self._at is None or not per_cell:
                self._client.multipliers = np.ones(len(self._space))
            else:
                largest = self._client.bounds()[1][self._at[:2]].min()
                self._client.multipliers = multipliers_of(self._space, self._factor, largest)
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
        """Report what is known and done; "" before there was an occasion to find out."""
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
        if self._since is None or (self.waits(now) and self._odd < ODD_CLOUDS):
            return ""
        return f"sets are sent as they are: no cost_cloud on {self._topic()} shows what the distance weights count"

    def _topic(self) -> str:
        return self._client.servers[PLANNER] + "/cost_cloud"

    def _resolution(self) -> float:
        """Return the local costmap's resolution [m], as the parameter server has it."""
        return float(rospy.get_param(self._client.namespace + "/local_costmap/resolution", 0.05))

    def _on_cloud(self, message: PointCloud2) -> None:
        values = self._client.values()
        if values is None or self._at is None:
            return
        rows = np.frombuffer(message.data, "<f4").reshape(-1, len(COST_FIELDS))
        factor = factor_of(rows, values[self._at], self._resolution())
        if factor is None:
            self._odd += 1
        elif self._factor is None:
            self._factor = factor
