"""Several policies as one, whose answer is the mean of theirs before tanh.

A policy and its mirror image differ although robot and planner are symmetric, since learning leaves errors in both.
Their mean is symmetric by construction, and has less of these errors. The same holds for policies of several seeds.
"""

from __future__ import annotations

from typing import Dict, Sequence

import numpy as np

Weights = Dict[str, np.ndarray]  # "0.weight" (out, in), "0.bias" (out,), "1.weight", ...: float32


def mirrored(weights: Weights, beams: int) -> Weights:
    """The network that answers an observation as the given one answers it with left and right exchanged.

    Args:
        weights: a policy's, whose input is a scan, then the angle of the local goal, then the parameters.
        beams: numbers of the scan, which reaches as far to the left as to the right.
    """
    first = weights["0.weight"].copy()
    first[..., :beams] = first[..., :beams][..., ::-1].copy()
    first[..., beams] *= -1.0
    return dict(weights, **{"0.weight": first})


def side_by_side(networks: Sequence[Weights]) -> Weights:
    """Networks of the same depth along the first axis of each tensor, as applr_ros1/policy/network.py takes them.

    Each of the networks may be several such already. Hidden layers are as wide as the widest: narrower networks get
    units whose weights are zero, which leaves their answers as they are.
    """
    stacks = [{k: t if _several(network) else t[None] for k, t in network.items()} for network in networks]
    widest = {name: np.max([stack[name].shape for stack in stacks], axis=0) for name in networks[0]}
    return {name: np.concatenate([_padded(stack[name], widest[name]) for stack in stacks]) for name in networks[0]}


def _padded(stack: np.ndarray, widest: np.ndarray) -> np.ndarray:
    """A stack of tensors with zeros behind each axis but the first, up to the lengths in `widest`."""
    return np.pad(stack, [(0, 0)] + [(0, most - has) for most, has in zip(widest[1:], stack.shape[1:])])


def _several(network: Weights) -> bool:
    return network["0.weight"].ndim == 3
