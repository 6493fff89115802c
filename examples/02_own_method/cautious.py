"""A method: slow where something is near, fast where there is room. docs/tutorials/own_method.md evaluates one."""

import numpy as np

from applr_ros1.policy.methods import Method
from applr_ros1.policy.parameter_space import SPACE


class Cautious(Method):
    """The speed limit follows the smallest range of the scan."""

    def theta(self, context) -> np.ndarray:
        """The parameters (8,) until the next decision; names left out keep their default."""
        slow = context.ranges.min() < 0.5
        return SPACE.from_dict({"max_vel_x": 0.4 if slow else 1.2, "inflation_radius": 0.3 if slow else 0.2})
