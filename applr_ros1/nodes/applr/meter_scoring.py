"""Detection of whether a planner's distance biases count per metre or per cell, and rescaling of parameter sets.

In C++, TrajectoryPlannerROS reads `meter_scoring` from uninitialised memory. From one start to the next, the same robot
may multiply path_distance_bias and goal_distance_bias by the costmap's resolution (per metre) or not (per cell), and
drive differently. Every policy and parameter set learned here is for a planner that counts per cell.
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

PLANNER = TRAJECTORY  # planner whose unit may vary: DWAPlannerROS always counts per metre
# weights of a trajectory's cost: two biases that meter_scoring multiplies, and one that it does not
WEIGHTS = ("path_distance_bias", "goal_distance_bias", "occdist_scale")
CLOSE = 0.002  # largest relative error of a cell's cost for a matching factor; float32 gives 1e-6
FEWEST = 20  # minimum number of cells from which the factor is determined
AUTO, TRUE, FALSE = CHOICES = ("auto", "true", "false")  # values of the parameter meter_scoring
PATIENCE_S = 1.0  # longest time for which a course's first decision waits for a cloud, in ROS time [s]


def indices_of(space: Space) -> Optional[List[int]]:
    """Return the indices in theta of the three WEIGHTS, or None unless the space contains all three."""
    indices = {name: i for i, target in space.targets_of(PLANNER) for name in target.names}
    return [indices[name] for name in WEIGHTS] if set(WEIGHTS) <= set(indices) else None


def factor_of(rows: np.ndarray, weights: np.ndarray, resolution: float) -> Optional[float]:
    """Return the factor that the planner applies to its two biases: 1.0 (per cell), or the resolution [m] (per metre).

    Args:
        rows: (n, 7) x, y, z [m], path, goal, obstacle and total cost of cells (cost_cloud). Rows of zeros, with which
            C++ pads its clouds, are ignored.
        weights: (3,) current values of WEIGHTS.
        resolution: Cell size of the local costmap [m].

    Returns:
        The factor, or None unless exactly one factor explains the total cost of every cell. This happens if the biases
        have just changed, or if there are too few cells.
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
    """Return the multipliers (n,) that convert a parameter set with biases per cell for a planner with this factor.

    The choice among trajectories depends only on the ratios of the three weights. If a bias would exceed its bound, all
    three weights are therefore divided by the same power of two.

    Args:
        space: The parameters. The multipliers are ones unless it contains all three weights.
        factor: Factor that the planner applies to its two biases, 1.0 or the resolution of the local costmap [m].
        largest: Upper bound of the planner's biases.
    """
    multipliers, indices = np.ones(len(space)), indices_of(space)
    if factor != 1.0 and indices is not None:
        path, goal, occ = indices
        wanted = 1.0 / factor
        excess = wanted * max(space.high[path], space.high[goal]) / largest
        multipliers[occ] = 0.5 ** max(0, math.ceil(math.log2(excess)))
        multipliers[[path, goal]] = wanted * multipliers[occ]
    return multipliers


class MeterScoring:
    """Detects the unit of the planner's distance biases, and sets the client's multipliers accordingly.

    All methods except the cloud's callback are called by the applr node's thread.

    Args:
        client: Client for the planner's parameters.
        choice: AUTO detects the unit from the cost_cloud of the first goal. TRUE and FALSE state whether the planner
            multiplies the biases by the local costmap's resolution.
    """

    def __init__(self, client: ReconfigureClient, choice: str = AUTO):
        self.choice = choice
        self._client, self._space = client, client.space
        self._at = indices_of(client.space)  # indices of WEIGHTS; None if the space has no distance biases
        self._subscriber: Optional[rospy.Subscriber] = None
        self.forget()

    def forget(self) -> None:
        """Reset the detection and the multipliers after a restart of the planner. May be called from any thread."""
        self._client.multipliers = np.ones(len(self._space))
        self._factor: Optional[float] = None  # factor that the planner applies to its biases, once it is known
        self._since: Optional[rospy.Time] = None  # ROS time at which the node subscribed
        self._used: Tuple[Optional[float], bool] = (None, False)  # (factor, per_cell) of the present multipliers
        self._line = ""

    def update(self, now: rospy.Time, driving: bool, per_cell: bool) -> bool:
        """Subscribe to clouds while the factor is unknown, log the result, and set the client's multipliers.

        Args:
            now: ROS time.
            driving: Whether there is a goal.
            per_cell: Whether the method's parameter sets count per cell (policy.decision.Method.per_cell).

        Returns:
            Whether the multipliers have changed.
        """
        if self._at is not None and self.choice != AUTO and self._factor is None:
            self._factor = self._resolution() if self.choice == TRUE else 1.0
        wanted = self._at is not None and driving and self._factor is None
        if wanted and self._since is None:
            self._since = now
        if wanted and self._subscriber is None:
            given = self._topic(), PointCloud2, self._on_cloud
            self._subscriber = rospy.Subscriber(*given, queue_size=1, buff_size=2**24)
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
        """Return whether a cloud that reveals the factor is still expected."""
        since = self._since
        listens = self._subscriber is not None and self._factor is None and since is not None
        return listens and (now - since).to_sec() < PATIENCE_S

    def line(self, now: rospy.Time) -> str:
        """Return a line about the detected unit and the multipliers, or "" before the first goal."""
        factors = zip(self._space.names, self._client.multipliers)
        sent = ", ".join(f"{name} x {factor:.6g}" for name, factor in factors if factor != 1.0)
        why = sent and f"the parameter set is for weights per cell and is sent as {sent}"
        return "; ".join(filter(None, [self._known(now), why]))

    def _known(self, now: rospy.Time) -> str:
        if self._at is None:
            return f"parameter sets are sent unchanged: only the distance weights of {PLANNER} are rescaled"
        if self._factor is not None:
            how = "measured from cost_cloud" if self.choice == AUTO else f"set by meter_scoring:={self.choice}"
            return f"the planner's distance weights count per {'cell' if self._factor == 1.0 else 'metre'} ({how})"
        if self._since is None or self.waits(now):
            return ""
        return f"parameter sets are sent unchanged: no cost_cloud on {self._topic()} shows the unit of distance weights"

    def _topic(self) -> str:
        return self._client.servers[PLANNER] + "/cost_cloud"

    def _resolution(self) -> float:
        """Return the local costmap's resolution [m] from the parameter server."""
        return float(rospy.get_param(self._client.namespace + "/local_costmap/resolution", 0.05))

    def _on_cloud(self, message: PointCloud2) -> None:
        values = self._client.values()
        if values is None or self._at is None:
            return
        rows = np.frombuffer(message.data, "<f4").reshape(-1, len(COST_FIELDS))
        self._factor = self._factor or factor_of(rows, values[self._at], self._resolution())
