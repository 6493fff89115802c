"""A multilayer perceptron in numpy: tensors by name are checked once, then applied. Actor, APPLD and workers use it.

Several networks of the same sizes can stand side by side in one file, along the first axis of each tensor; then the
answer is the mean of their outputs.
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError

MAX_LAYERS = 16
Layers = List[Tuple[np.ndarray, np.ndarray]]


def layers_of(weights: Mapping[str, np.ndarray], inputs: int, outputs: int, name: str) -> Layers:
    """Return [(weight (out, in), bias (out,)), ...] float32, after checking names, types, shapes and values.

    Args:
        weights: {"0.weight": (h, inputs), "0.bias": (h,), "1.weight": ..., the last (outputs, h)}. Of k networks side
            by side each has a first axis more, of k.
        inputs: Width of the input.
        outputs: Width of the output.
        name: What the error's line begins with, a file's path for instance.
    """
    layers: Layers = []
    width, count = inputs, len(weights) // 2
    names = {"%d.%s" % (i, kind) for i in range(count) for kind in ("weight", "bias")}
    if not 1 <= count <= MAX_LAYERS or set(weights) != names:
        there = ", ".join(sorted(weights)[:6])
        raise ApplrError("%s: tensors are %s...: 0.weight, 0.bias, 1.weight... needed" % (name, there))
    side_by_side = weights["0.weight"].shape[:-2][:1]
    for i in range(count):
        weight, bias = weights["%d.weight" % i], weights["%d.bias" % i]
        rows = outputs if i == count - 1 else bias.shape[-1] if bias.ndim else 0
        needed = (*side_by_side, rows, width), (*side_by_side, rows)
        if (weight.shape, bias.shape) != needed or 0 in side_by_side:
            raise ApplrError(
                "%s: layer %d has shapes %s and %s, %s and %s needed" % (name, i, weight.shape, bias.shape, *needed)
            )
        if weight.dtype != np.float32 or bias.dtype != np.float32:
            raise ApplrError("%s: layer %d is %s, float32 needed" % (name, i, weight.dtype))
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ApplrError("%s: layer %d holds NaN or inf; train or copy it again" % (name, i))
        layers.append((weight, bias))
        width = rows
    return layers


class Mirror(NamedTuple):
    """The change of an observation x where left and right are exchanged: it becomes x[order] * sign.

    order: (n,) int; sign: (n,) float32, 1 or -1.
    """

    order: np.ndarray
    sign: np.ndarray

    @classmethod
    def of(cls, beams: int, rest: int, scans: int = 1, odd: Tuple[int, ...] = (0,)) -> Mirror:
        """Make it for `scans` scans, `beams` numbers together, and `rest` more, of which those at `odd` turn round."""
        order, sign = np.arange(beams + rest), np.ones(beams + rest, np.float32)
        order[:beams] = order[:beams].reshape(scans, -1)[:, ::-1].ravel()
        sign[[beams + i for i in odd]] = -1.0
        return cls(order, sign)


def mirrored(weights: Mapping[str, np.ndarray], mirror: Mirror) -> Dict[str, np.ndarray]:
    """Return the network that answers an observation as the given one answers its mirror image."""
    return dict(weights, **{"0.weight": (weights["0.weight"] * mirror.sign)[..., mirror.order]})


def with_mirror_images(weights: Mapping[str, np.ndarray], mirror: Mirror) -> Dict[str, np.ndarray]:
    """Return networks side by side, each followed by the one that answers as it does with left and right exchanged.

    Args:
        weights: One network, or several side by side.
        mirror: What exchanging left and right does to their input.
    """
    several = {name: t if weights["0.weight"].ndim == 3 else t[None] for name, t in weights.items()}
    images = mirrored(several, mirror)
    return {name: np.stack([t, images[name]], axis=1).reshape(-1, *t.shape[1:]) for name, t in several.items()}


def forward(layers: Layers, x: Any) -> np.ndarray:
    """Return the network's output before a last activation. x (n, inputs) or (inputs,), of which NaN passes."""
    x = np.asarray(x, dtype=np.float32)
    several, shape = layers[0][0].ndim == 3, x.shape[:-1]
    units = np.atleast_2d(x) if several else x  # of k networks side by side (k, n, units) after the first layer
    for layer in layers[:-1]:
        units = np.maximum(_linear(layer, units), np.float32(0.0))
    out = _linear(layers[-1], units)
    return out.mean(axis=0).reshape(*shape, -1) if several else out


def _linear(layer: Tuple[np.ndarray, np.ndarray], x: np.ndarray) -> np.ndarray:
    weight, bias = layer
    return x @ weight.swapaxes(-1, -2) + (bias[:, None, :] if weight.ndim == 3 else bias)
