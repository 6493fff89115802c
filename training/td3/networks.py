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
        inputs: width of the input, which begins with `scan` beams.
        hidden: widths of the hidden layers.
        outputs: width of the output.
        scan: number of beams.
        scan_pool: that many neighbouring beams are averaged to one input; 1 takes each beam by itself.
        layer_norm: normalise each hidden layer (without gain and shift) before its ReLU. On critics this bounds how far
            values are extrapolated to actions that were never tried, which keeps several gradient steps per transition
            stable (Ball et al. 2023; Nauman et al. 2024).
    """

    def __init__(
        self,
        inputs: int,
        hidden: Sequence[int],
        outputs: int,
        scan: int = 0,
        scan_pool: int = 1,
        layer_norm: bool = False,
    ):
        sizes = [inputs - scan + scan // scan_pool, *hidden, outputs]
        super().__init__(nn.Linear(width, out) for width, out in zip(sizes[:-1], sizes[1:]))
        self.scan, self.scan_pool, self.layer_norm = scan, scan_pool, layer_norm

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map x (B, inputs) to (B, outputs)."""
        if self.scan_pool > 1:
            beams = functional.avg_pool1d(x[:, None, : self.scan], self.scan_pool)[:, 0]
            x = torch.cat((beams, x[:, self.scan :]), 1)
        *hidden, last = self
        for layer in hidden:
            x = layer(x)
            x = functional.relu(functional.layer_norm(x, x.shape[1:]) if self.layer_norm else x)
        return last(x)

    def weights(self) -> Weights:
        """Copies of the tensors, of a network that takes every beam: a mean is linear, so the first layer absorbs it.

        Layer normalisation is not part of them; policies have none.
        """
        weights = {name: tensor.cpu().numpy().copy() for name, tensor in self.state_dict().items()}
        if self.scan_pool > 1:
            first, pooled = weights["0.weight"], self.scan // self.scan_pool
            beams = np.repeat(first[:, :pooled] / np.float32(self.scan_pool), self.scan_pool, axis=1)
            weights["0.weight"] = np.concatenate((beams, first[:, pooled:]), axis=1)
        return weights


def parameters(*networks: nn.Module) -> List[torch.Tensor]:
    """The parameters of several networks in one list, as torch._foreach_lerp_ takes them."""
    return [parameter for network in networks for parameter in network.parameters()]
