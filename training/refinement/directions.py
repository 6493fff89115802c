"""The directions in which a policy is shifted: constants and leading variations of its last hidden layer, per output.

The outputs before tanh become y + b + A f. f are the leading principal components of the last hidden layer over the
observations of a number of drives, scaled to a variance of 1, so that b (one number for each parameter) and A (one for
each parameter and component) are alike in their effect. All of it goes into the weights and biases of the last layer:
a shifted policy is a policy of the same size.
"""

from __future__ import annotations

import numpy as np

from applr_ros1.policy import network
from applr_ros1.policy.network import Mirror, mirrored
from training.td3.networks import Weights


class Directions:
    """Principal components of a policy's last hidden layer.

    Args:
        mean: (n,) mean of the units of the last hidden layer; networks side by side stand one after the other, each
            divided by their number.
        basis: (k, n) the components, so that (units - mean) @ basis.T has variance 1 in each of its k columns.
    """

    def __init__(self, mean: np.ndarray, basis: np.ndarray):
        self.mean, self.basis = np.asarray(mean, np.float32), np.asarray(basis, np.float32)

    @classmethod
    def found(cls, weights: Weights, observations: np.ndarray, mirror: Mirror, components: int) -> "Directions":
        """The leading components over observations.

        Left and right are treated alike: each observation counts with its mirror image, as a mean of the two. In a
        policy that is the mean of itself and its mirror image, no shift then disturbs the symmetry.

        Args:
            weights: the policy's tensors.
            observations: (m, inputs) of drives; m is greater than `components`.
            mirror: what exchanging left and right does to an observation.
            components: how many to take.
        """
        units = 0.5 * (hidden(weights, observations) + hidden(mirrored(weights, mirror), observations))
        mean = units.mean(axis=0)
        _, singular, axes = np.linalg.svd(units - mean, full_matrices=False)
        deviation = singular[:components, None] / np.sqrt(len(units))
        return cls(mean, axes[:components] / np.maximum(deviation, 1e-6))

    def shifted(self, weights: Weights, coefficients: np.ndarray) -> Weights:
        """The policy's tensors with b = coefficients[:, 0] and A = coefficients[:, 1:] in the last layer.

        coefficients: (parameters, 1 + components).
        """
        constants, slopes = coefficients[:, 0], coefficients[:, 1:]
        last = len(weights) // 2 - 1
        weight, bias = weights["%d.weight" % last], weights["%d.bias" % last]
        by_unit = (slopes @ self.basis).reshape(len(constants), -1, weight.shape[-1])  # (out, networks, units)
        added = by_unit.swapaxes(0, 1) if weight.ndim == 3 else by_unit[:, 0]
        return {
            **weights,
            "%d.weight" % last: (weight + added).astype(np.float32),
            "%d.bias" % last: (bias + constants - slopes @ (self.basis @ self.mean)).astype(np.float32),
        }


def hidden(weights: Weights, observations: np.ndarray) -> np.ndarray:
    """The units of the last hidden layer (m, n) for observations (m, inputs).

    Networks side by side stand one after the other, each divided by their number, so that the mean of their outputs is
    a linear function of the units.
    """
    layers = [(weights["%d.weight" % i], weights["%d.bias" % i]) for i in range(len(weights) // 2)]
    units = network.hidden(layers, np.asarray(observations, np.float32))
    return np.concatenate(units / np.float32(len(units)), axis=1) if units.ndim == 3 else units
