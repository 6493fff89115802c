"""The multilayer perceptrons of TD3 (td3.py)."""

from __future__ import annotations

from typing import Dict, List, Sequence

import numpy as np
import torch
from torch import nn
from torch.nn import functional

Weights = Dict[str, np.ndarray]  # "0.weight" (out, in), "0.bias" (out,), "1.weight", ...: float32


class MLP(nn.ModuleList):
    """Linear layers with ReLU between them; state_dict() names them "0.weight" (out, in), "0.bias" (out,), "1.weight".

    Args:
        inputs: width of the input.
        hidden: widths of the hidden layers.
        outputs: width of the output.
        layer_norm: normalise each hidden layer (without gain and shift) before its ReLU. On critics this bounds how far
            values are extrapolated to actions that were never tried, which keeps several gradient steps per transition
            stable (Ball et al. 2023; Nauman et al. 2024).
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, layer_norm: bool = False):
        sizes = [inputs, *hidden, outputs]
        super().__init__(nn.Linear(width, out) for width, out in zip(sizes[:-1], sizes[1:]))
        self.layer_norm = layer_norm

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map x (B, inputs) to (B, outputs)."""
        *hidden, last = self
        for layer in hidden:
            x = layer(x)
            x = functional.relu(functional.layer_norm(x, x.shape[1:]) if self.layer_norm else x)
        return last(x)

    def weights(self) -> Weights:
        """Copies of the tensors. Layer normalisation is not part of them; policies have none."""
        return {name: tensor.cpu().numpy().copy() for name, tensor in self.state_dict().items()}


def parameters(*networks: nn.Module) -> List[torch.Tensor]:
    """The parameters of several networks in one list, as torch._foreach_lerp_ takes them."""
    return [parameter for network in networks for parameter in network.parameters()]
