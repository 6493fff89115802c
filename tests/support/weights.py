"""Random weights of a policy's network."""

import numpy as np


def make_weights(seed=0, hidden=(32, 32), inputs=729, outputs=8):
    rng = np.random.default_rng(seed)
    widths = (inputs,) + tuple(hidden) + (outputs,)
    weights = {}
    for i, (a, b) in enumerate(zip(widths, widths[1:])):
        weights[f"{i}.weight"] = (rng.normal(size=(b, a)) / np.sqrt(a)).astype(np.float32)
        weights[f"{i}.bias"] = rng.normal(size=b).astype(np.float32)
    return weights
