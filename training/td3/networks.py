"""Multilayer perceptrons with their gradients written out: what TD3 (td3.py) is made of.

Written out because it is twice as fast: on AMD processors torch's own float32 products run on half of the vector width,
oneDNN's do not, and the gradients that nobody needs (of the critic's weights in the actor's step) are never computed.
"""

from __future__ import annotations

import math
from typing import Dict, List, Sequence, Tuple

import numpy as np
import torch

Layer = Tuple[torch.Tensor, torch.Tensor]
SMALL = 64  # fewer outputs than this: torch's own product is quicker


def _onednn():
    """oneDNN's linear operator, or None where torch has it not, or where it fails."""
    try:
        operator = torch.ops.mkldnn._linear_pointwise
        operator(torch.ones(2, 2), torch.ones(2, 2), None, "none", [], "")
        return operator
    except (AttributeError, RuntimeError, TypeError):
        return None


_ONEDNN = _onednn()


def linear(x: torch.Tensor, weight: torch.Tensor, bias=None, relu: bool = False) -> torch.Tensor:
    """x (B, in) @ weight (out, in)^T + bias (out,), then ReLU if asked: (B, out). Any strides."""
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
    """ReLU layers and a linear one. layers: [(weight (out, in), bias (out,)), ...] float32, changed in place."""

    def __init__(self, sizes: Sequence[int], rng: np.random.Generator, device="cpu"):
        self.layers: List[Layer] = []
        for width, out in zip(sizes[:-1], sizes[1:]):
            bound = 1.0 / math.sqrt(width)  # torch.nn.Linear's own start
            self.layers.append(
                tuple(
                    torch.from_numpy(rng.uniform(-bound, bound, shape).astype(np.float32)).to(device)
                    for shape in ((out, width), (out,))
                )
            )

    @property
    def parameters(self) -> List[torch.Tensor]:
        return [tensor for layer in self.layers for tensor in layer]

    def copy(self) -> "MLP":
        other = object.__new__(MLP)
        other.layers = [(w.clone(), b.clone()) for w, b in self.layers]
        return other

    def forward(self, x: torch.Tensor, keep: List[torch.Tensor] = None) -> torch.Tensor:
        """x (B, in) → (B, out). With `keep` (an empty list) it remembers what backward needs."""
        for i, (weight, bias) in enumerate(self.layers):
            if keep is not None:
                keep.append(x)
            x = linear(x, weight, bias, relu=i + 1 < len(self.layers))
        return x

    def backward(self, kept: List[torch.Tensor], dy: torch.Tensor) -> List[torch.Tensor]:
        """Gradients of all parameters, for the loss's gradient dy (B, out) at the output."""
        gradients: List[torch.Tensor] = []
        for i in range(len(self.layers) - 1, -1, -1):
            gradients[:0] = (linear(dy.t(), kept[i].t()), dy.sum(0))
            if i:
                dy = self._through(i, kept, dy)
        return gradients

    def input_gradient(self, kept: List[torch.Tensor], dy: torch.Tensor, columns: slice) -> torch.Tensor:
        """The loss's gradient at some columns of the input, and no parameter's: (B, columns)."""
        for i in range(len(self.layers) - 1, 0, -1):
            dy = self._through(i, kept, dy)
        return torch.mm(dy, self.layers[0][0][:, columns])

    def _through(self, i, kept, dy):
        """From layer i's output back to the output of layer i - 1, before its ReLU."""
        dx = linear(dy, self.layers[i][0].t())
        return torch.ops.aten.threshold_backward.grad_input(dx, kept[i], 0.0, grad_input=dx)

    def state(self, prefix: str = "") -> Dict[str, torch.Tensor]:
        """{prefix + "0.weight": ..., "0.bias": ..., "1.weight": ...}: the parameters themselves, not copies."""
        return {
            "%s%d.%s" % (prefix, i, kind): tensor
            for i, layer in enumerate(self.layers)
            for kind, tensor in zip(("weight", "bias"), layer)
        }
