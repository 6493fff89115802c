"""Method that evaluates a network of another project, from a file in the same folder.

docs/tutorials/own_method.md describes it.
"""

from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from applr_ros1.policy.decision import Context
from applr_ros1.policy.methods import Method
from applr_ros1.policy.parameter_space import SPACE


class ForeignNetwork(Method):
    """Method whose parameters are the outputs of a fully connected network."""

    period = 1.0
    # Parameter and range of each output of the network
    ranges = {"max_vel_x": (0.2, 2.0), "inflation_radius": (0.1, 0.6)}

    def __init__(self) -> None:
        tensors = load_file(Path(__file__).with_name("actor.safetensors"))
        self.layers = [
            (tensors[f"{i}.weight"], tensors[f"{i}.bias"]) for i in range(len(tensors) // 2)
        ]

    def theta(self, context: Context) -> np.ndarray:
        """Return the parameters (n,) until the next decision."""
        # The network observes the scan, capped at 2 m, and the angle to the local goal.
        x = np.append(np.minimum(context.ranges, 2.0) / 2.0, context.phi / np.pi)
        *hidden_layers, (last_weight, last_bias) = self.layers
        for weight, bias in hidden_layers:
            x = np.maximum(x @ weight.T + bias, 0.0)
        x = x @ last_weight.T + last_bias
        low, high = np.transpose(list(self.ranges.values()))
        values = low + 0.5 * (np.tanh(x) + 1.0) * (high - low)
        return SPACE.clip(SPACE.from_dict(dict(zip(self.ranges, values))))
