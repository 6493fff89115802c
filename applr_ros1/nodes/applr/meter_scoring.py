"""Detection of whether a planner's distance biases count per metre or per cell.

In C++, TrajectoryPlannerROS reads `meter_scoring` from uninitialised memory. From one start to the
next, the same robot may multiply path_distance_bias and goal_distance_bias by the costmap's
resolution (per metre) or not (per cell), and drive differently. Every policy and parameter set
learned here is for a planner that counts per cell.
"""

from __future__ import annotations

from typing import Optional

import numpy as np
import rospy
from sensor_msgs.msg import PointCloud2

from applr_ros1.common.arrays import Array
from applr_ros1.common.ros_node import LARGE_BUFFER
from applr_ros1.nodes.applr.distance_weights import PLANNER, weights_at
from applr_ros1.nodes.applr.reconfigure_client import ReconfigureClient
from applr_ros1.nodes.conversions import COST_FIELDS

CLOSE = 0.002  # largest relative error of a cell's cost for a matching factor; float32 gives 1e-6
FEWEST = 20  # minimum number of cells from which the factor is determined
# Values of the parameter meter_scoring
AUTO = "auto"
TRUE = "true"
FALSE = "false"
CHOICES = (AUTO, TRUE, FALSE)
# Longest time for which a course's first decision waits for a cloud, in ROS time [s]
PATIENCE_S = 1.0
UNCHANGED = "parameter sets are sent unchanged"


def factor_of(rows: Array, weights: Array, resolution: float) -> Optional[float]:
    """Return the factor that the planner applies to its biases: 1.0, or the resolution [m].

    Args:
        rows: (n, 7) x, y, z [m], path, goal, obstacle and total cost of cells (cost_cloud). Rows of
            zeros, with which C++ pads its clouds, are ignored.
        weights: (3,) current values of WEIGHTS.
        resolution: Cell size of the local costmap [m].

    Returns:
        The factor, or None unless exactly one factor explains the total cost of every cell. This
        happens if the biases have just changed, or if there are too few cells.
    """
    rows = np.asarray(rows, dtype=np.float64)
    rows = rows[np.isfinite(rows).all(axis=1) & (rows[:, 6] > 0.0)]
    if len(rows) < FEWEST:
        return None
    path_weight, goal_weight, obstacle_weight = weights
    distance_costs = path_weight * rows[:, 3] + goal_weight * rows[:, 4]
    obstacle_costs = obstacle_weight * rows[:, 5]
    totals = rows[:, 6]
    # With small biases both factors may fit.
    fitting = []
    for factor in (1.0, resolution):
        errors = np.abs(factor * distance_costs + obstacle_costs - totals)
        if (errors <= CLOSE * totals).all():
            fitting.append(factor)
    return fitting[0] if len(fitting) == 1 else None


class MeterScoring:
    """Detects the unit of the planner's distance biases, and reports it to the client.

    All methods except the cloud's callback are called by the applr node's thread.

    Args:
        client: Client for the planner's parameters.
        choice: AUTO detects the unit from the cost_cloud of the first goal. TRUE and FALSE state
            whether the planner multiplies the biases by the local costmap's resolution.
    """

    def __init__(self, client: ReconfigureClient, choice: str = AUTO):
        self.choice = choice
        self._client = client
        # Indices of WEIGHTS; None if the space has no distance biases
        self._indices = weights_at(client.space)
        self._subscriber: Optional[rospy.Subscriber] = None
        self.forget()

    def forget(self) -> None:
        """Reset the detection after a restart of the planner. May be called from any thread."""
        self._client.factor = None
        # Factor that the planner applies to its biases, once it is known
        self._factor: Optional[float] = None
        self._since: Optional[rospy.Time] = None  # ROS time at which the node subscribed
        self._line = ""

    def detect(self, now: rospy.Time, driving: bool) -> bool:
        """Subscribe to clouds while the factor is unknown, and report it to the client.

        Args:
            now: ROS time.
            driving: Whether there is a goal.

        Returns:
            Whether the client's multipliers have changed.
        """
        has_biases = self._indices is not None
        if has_biases and self.choice != AUTO and self._factor is None:
            self._factor = self._resolution() if self.choice == TRUE else 1.0

        # move_base publishes clouds only while it drives, and they cost it time.
        is_wanted = has_biases and driving and self._factor is None
        if is_wanted and self._since is None:
            self._since = now
        if is_wanted and self._subscriber is None:
            self._subscriber = rospy.Subscriber(
                self._topic(), PointCloud2, self._on_cloud, queue_size=1, buff_size=LARGE_BUFFER
            )
        elif not is_wanted and self._subscriber is not None:
            self._subscriber.unregister()
            self._subscriber = None

        former_multipliers = self._client.multipliers
        self._client.factor = self._factor
        line = self.line(now)
        if line not in ("", self._line):
            rospy.loginfo("applr: %s", line)
        self._line = line
        return not np.array_equal(former_multipliers, self._client.multipliers)

    def waits(self, now: rospy.Time) -> bool:
        """Return whether a cloud that reveals the factor is still expected."""
        since = self._since
        listens = self._subscriber is not None and self._factor is None and since is not None
        return listens and (now - since).to_sec() < PATIENCE_S

    def line(self, now: rospy.Time) -> str:
        """Return a line about unit and multipliers, or "" before the first goal."""
        unit = self._unit(now)
        rescaled = []
        for parameter_name, factor in zip(self._client.space.names, self._client.multipliers):
            if factor != 1.0:
                rescaled.append(f"{parameter_name} x {factor:.6g}")
        if not rescaled:
            return unit
        effect = "the parameter set is for weights per cell and is sent as "
        return f"{unit}; {effect}{', '.join(rescaled)}"

    def _unit(self, now: rospy.Time) -> str:
        """Return a line about the detected unit, or "" before it is detected."""
        if self._indices is None:
            return f"{UNCHANGED}: only the distance weights of {PLANNER} are rescaled"
        if self._factor is not None:
            source = "measured from cost_cloud"
            if self.choice != AUTO:
                source = f"set by meter_scoring:={self.choice}"
            unit = "cell" if self._factor == 1.0 else "metre"
            return f"the planner's distance weights count per {unit} ({source})"
        if self._since is None or self.waits(now):
            return ""
        missing_cloud = f"no cost_cloud on {self._topic()}"
        return f"{UNCHANGED}: {missing_cloud} shows the unit of distance weights"

    def _topic(self) -> str:
        return self._client.servers[PLANNER].name + "/cost_cloud"

    def _resolution(self) -> float:
        """Return the local costmap's resolution [m] from the parameter server."""
        return float(rospy.get_param(self._client.namespace + "/local_costmap/resolution", 0.05))

    def _on_cloud(self, message: PointCloud2) -> None:
        values = self._client.values()
        if values is None or self._indices is None:
            return
        rows = np.frombuffer(message.data, "<f4").reshape(-1, len(COST_FIELDS))
        weights = values[self._indices]
        self._factor = self._factor or factor_of(rows, weights, self._resolution())
