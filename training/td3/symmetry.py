"""The mirror image of a policy. Robot and planner are symmetric, but a learnt policy is so only approximately."""

from __future__ import annotations

from typing import Dict

import numpy as np

Weights = Dict[str, np.ndarray]  # "0.weight" (out, in), "0.bias" (out,), "1.weight", ...: float32


def mirrored(weights: Weights, beams: int) -> Weights:
    """The network that answers an observation as the given one answers it with left and right exchanged.

    Args:
        weights: of a policy whose input is a scan, then the angle of the local goal, then the parameters.
        beams: length of the scan, which covers the same angle on the left as on the right.
    """
    first = weights["0.weight"].copy()
    first[..., :beams] = first[..., :beams][..., ::-1].copy()
    first[..., beams] *= -1.0
    return dict(weights, **{"0.weight": first})
