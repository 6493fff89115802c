"""Means of policies as one policy: networks side by side, whose outputs are averaged before tanh.

A policy and its mirror image differ although robot and planner are symmetric, since learning leaves errors in both.
Their mean is symmetric by construction, and the errors of one are halved. The same holds for policies of several seeds.
"""

from __future__ import annotations

from typing import Dict, Sequence

import numpy as np

Weights = Dict[str, np.ndarray]  # "0.weight" (out, in), "0.bias" (out,), "1.weight", ...: float32


def mirrored(weights: Weights, beams: int) -> Weights:
    """The network that answers an observation as the given one answers it with left and right exchanged.

    Args:
        weights: a policy's, whose input is a scan, then the angle of the local goal, then the parameters.
        beams: numbers of the scan, which are as far to the left as to the right.
    """
    first = weights["0.weight"].copy()
    first[:, :beams] = first[:, :beams][:, ::-1].copy()
    first[:, beams] *= -1.0
    return dict(weights, **{"0.weight": first})


def mean(networks: Sequence[Weights]) -> Weights:
    """One network whose output, before any last activation, is the mean of the given ones' outputs.

    Its hidden layers are as wide as theirs together. All have the same number of layers, inputs and outputs.
    """
    layers = len(networks[0]) // 2
    result = {}
    for i in range(layers):
        weights = [network["%d.weight" % i] for network in networks]
        biases = [network["%d.bias" % i] for network in networks]
        if i == layers - 1:
            result["%d.weight" % i] = np.concatenate(weights, axis=1) / np.float32(len(networks))
            result["%d.bias" % i] = np.mean(biases, axis=0, dtype=np.float32)
            continue
        result["%d.weight" % i] = np.concatenate(weights) if i == 0 else _diagonal(weights)
        result["%d.bias" % i] = np.concatenate(biases)
    if layers == 1:  # nothing is between input and output: the mean of the weights is the network
        result["0.weight"] = np.mean([network["0.weight"] for network in networks], axis=0, dtype=np.float32)
    return result


def _diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    whole = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)), np.float32)
    row = column = 0
    for block in blocks:
        whole[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return whole
