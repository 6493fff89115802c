"""Multilayer perceptrons with their gradients written out: what TD3 (td3.py) is made of.

Written out because it is twice as fast: on AMD processors torch's own float32 products run on half of the vector width,
oneDNN's do not, and the gradients that nobody needs (of the critic's weights in the actor's step) are never computed.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import torch

Layer = Tuple[torch.Tensor, torch.Tensor]
Kept = List[Any]  # inputs of the layers, and between them what normalisations keep
NORM_EPSILON = 1e-5
SMALL = 64  # fewer outputs than this: torch's own product is quicker


def _onednn():
    """The linear operator of oneDNN; None where torch lacks it or where it fails."""
    try:
        operator = torch.ops.mkldnn._linear_pointwise
        operator(torch.ones(2, 2), torch.ones(2, 2), None, "none", [], "")
        return operator
    except (AttributeError, RuntimeError, TypeError):
        return None


_ONEDNN = _onednn()


def linear(x: torch.Tensor, weight: torch.Tensor, bias=None, relu: bool = False, half: bool = False) -> torch.Tensor:
    """One layer: x (B, in) @ weight (out, in)^T + bias (out,), then ReLU if asked; (B, out) float32. Any strides.

    half: the product of the factors rounded to bfloat16. Processors that know the type sum such products in float32
    and are twice as fast.
    """
    if half:
        y = torch.mm(x.to(torch.bfloat16), weight.to(torch.bfloat16).t()).to(torch.float32)
        if bias is not None:
            y += bias
        return y.relu_() if relu else y
    if (
        _ONEDNN is not None
        and x.device.type == "cpu"
        and x.dtype == torch.float32
        and weight.shape[0] >= SMALL
        and x.shape[0] >= SMALL
    ):
        return _ONEDNN(x, weight, bias, "relu" if relu else "none", [], "")
    y = torch.mm(x, weight.t()) if bias is None else torch.addmm(bias, x, weight.t())
    return y.relu_() if relu else y


class MLP:
    """Hidden layers with ReLU and a linear output layer.

    Attributes:
        layers: [(weight (out, in), bias (out,)), ...] float32, changed in place by the optimiser.
        normalised: whether each hidden layer is normalised (Ba et al. 2016, without gain and shift) before its ReLU.
            On critics this bounds how far values are extrapolated to actions that were never tried, which is what
            makes several gradient steps per transition stable (Ball et al. 2023; Nauman et al. 2024).
        half: whether the hidden layers' products are computed in bfloat16; weights, sums and the last layer stay
            float32.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        rng: np.random.Generator,
        device="cpu",
        normalised: bool = False,
        half: bool = False,
    ):
        self.normalised, self.half = normalised, half
        self.layers: List[Layer] = []
        for width, out in zip(sizes[:-1], sizes[1:]):
            bound = 1.0 / math.sqrt(width)  # torch.nn.Linear's own start
            weight, bias = (
                torch.from_numpy(rng.uniform(-bound, bound, shape).astype(np.float32)).to(device)
                for shape in ((out, width), (out,))
            )
            self.layers.append((weight, bias))

    @property
    def parameters(self) -> List[torch.Tensor]:
        """All weights and biases, layer by layer."""
        return [tensor for layer in self.layers for tensor in layer]

    def copy(self) -> "MLP":
        """A network with the same values in other memory."""
        other = object.__new__(MLP)
        other.normalised, other.half = self.normalised, self.half
        other.layers = [(w.clone(), b.clone()) for w, b in self.layers]
        return other

    def forward(self, x: torch.Tensor, keep: Optional[Kept] = None) -> torch.Tensor:
        """Map x (B, in) to (B, out). Into `keep`, an empty list, goes what backward needs."""
        last = len(self.layers) - 1
        for i, (weight, bias) in enumerate(self.layers):
            half = self.half and i < last
            if keep is not None:
                keep.append(x)
            if self.normalised and i < last:
                z = linear(x, weight, bias, half=half)
                y, mean, deviation = torch.native_layer_norm(z, z.shape[1:], None, None, NORM_EPSILON)
                if keep is not None:
                    keep.append((z, mean, deviation))
                x = y.relu_()
            else:
                x = linear(x, weight, bias, relu=i < last, half=half)
        return x

    def backward(self, kept: Kept, dy: torch.Tensor) -> List[torch.Tensor]:
        """Gradients of all parameters, for the loss's gradient dy (B, out) at the output."""
        inputs, norms = self._sorted(kept)
        gradients: List[torch.Tensor] = []
        last = len(self.layers) - 1
        for i in range(last, -1, -1):
            gradients[:0] = (linear(dy.t(), inputs[i].t(), half=self.half and i < last), dy.sum(0))
            if i:
                dy = self._through(i, inputs, norms, dy)
        return gradients

    def input_gradient(self, kept: Kept, dy: torch.Tensor, columns: slice) -> torch.Tensor:
        """The loss's gradient at some columns of the input, and no parameter's: (B, columns)."""
        inputs, norms = self._sorted(kept)
        for i in range(len(self.layers) - 1, 0, -1):
            dy = self._through(i, inputs, norms, dy)
        return torch.mm(dy, self.layers[0][0][:, columns])

    def _sorted(self, kept):
        """(inputs of the layers, what the normalisations of the hidden layers keep)."""
        if not self.normalised:
            return kept, ()
        return [*kept[0::2]], kept[1::2]

    def _through(self, i, inputs, norms, dy):
        """From layer i's output back to the output of layer i - 1, before its ReLU (and its normalisation)."""
        dx = linear(dy, self.layers[i][0].t(), half=self.half and i < len(self.layers) - 1)
        dx = torch.ops.aten.threshold_backward.grad_input(dx, inputs[i], 0.0, grad_input=dx)
        if not self.normalised:
            return dx
        z, mean, deviation = norms[i - 1]
        return torch.ops.aten.native_layer_norm_backward(
            dx, z, z.shape[1:], mean, deviation, None, None, [True, False, False]
        )[0]

    def state(self, prefix: str = "") -> Dict[str, torch.Tensor]:
        """{prefix + "0.weight": ..., "0.bias": ..., "1.weight": ...}: the parameters themselves, not copies."""
        return {
            "%s%d.%s" % (prefix, i, kind): tensor
            for i, layer in enumerate(self.layers)
            for kind, tensor in zip(("weight", "bias"), layer)
        }
