"""Method that drives slowly near obstacles, and fast otherwise.

docs/tutorials/own_method.md evaluates it.
"""

import numpy as np

from applr_ros1.policy.decision import Context
from applr_ros1.policy.methods import Method
from applr_ros1.policy.parameter_space import SPACE


class Cautious(Method):
    """Method whose speed limit depends on the smallest range of the scan."""

    def theta(self, context: Context) -> np.ndarray:
        """Return the parameters (n,) until the next decision.

        Parameters left out keep their default.
        """
        slow = context.ranges.min() < 0.5
        return SPACE.from_dict(
            {"max_vel_x": 0.4 if slow else 1.2, "inflation_radius": 0.3 if slow else 0.2}
        )
