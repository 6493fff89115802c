"""What a critic's outputs mean: one number, or a distribution over values. td3.py learns through either.

A critic that classifies (Farebrother et al. 2024, "Stop Regressing") is hurt less by the few returns that are far off
the rest, here of courses on which the robot stays stuck: its gradient is bounded, that of a squared error is not.
"""

from __future__ import annotations

import math
from typing import Tuple

import torch


class Regression:
    """One output, the value itself, learnt with the squared error (the paper's).

    Attributes:
        outputs: how many outputs a critic has.
    """

    outputs = 1

    def value(self, out: torch.Tensor) -> torch.Tensor:
        """(B, 1) values of a critic's outputs (B, outputs)."""
        return out

    def error(self, out: torch.Tensor, y: torch.Tensor) -> Tuple[torch.Tensor, torch.Tensor]:
        """The loss of the outputs (B, outputs) for target values y (B, 1), and its gradient at the outputs."""
        error = out - y
        return error.square().mean(), error * (2.0 / len(y))

    def gradient(self, out: torch.Tensor, dq: torch.Tensor) -> torch.Tensor:
        """A loss's gradient at the outputs (B, outputs), for its gradient dq (B, 1) at the values."""
        return dq


class Classification:
    """Logits over `bins` equal intervals of values; the value is the mean of the intervals' centres.

    The target is a normal distribution around y, 3/4 of an interval wide (HL-Gauss), learnt with the cross entropy.
    Target values beyond the ends count as the ends.

    Args:
        low, high: ends of the range of values.
        bins: intervals, at least 2.
        device: where the tensors lie.
    """

    SPREAD = 0.75

    def __init__(self, low: float, high: float, bins: int, device: torch.device):
        self.outputs, self.low, self.high = bins, low, high
        edges = torch.linspace(low, high, bins + 1, dtype=torch.float32, device=device)
        self.edges, self.centres = edges[None, :], ((edges[1:] + edges[:-1]) / 2.0)[:, None]
        self.scale = 1.0 / (math.sqrt(2.0) * self.SPREAD * (high - low) / bins)

    def value(self, out: torch.Tensor) -> torch.Tensor:
        """(B, 1) values of a critic's outputs (B, outputs)."""
        return torch.mm(torch.softmax(out, 1), self.centres)

    def error(self, out: torch.Tensor, y: torch.Tensor) -> Tuple[torch.Tensor, torch.Tensor]:
        """The loss of the outputs (B, outputs) for target values y (B, 1), and its gradient at the outputs."""
        below = torch.erf((self.edges - y.clamp(self.low, self.high)).mul_(self.scale))
        target = below[:, 1:] - below[:, :-1]
        target /= below[:, -1:] - below[:, :1]
        logarithms = torch.log_softmax(out, 1)
        return -(target * logarithms).sum(1).mean(), (logarithms.exp_() - target).div_(len(y))

    def gradient(self, out: torch.Tensor, dq: torch.Tensor) -> torch.Tensor:
        """A loss's gradient at the outputs (B, outputs), for its gradient dq (B, 1) at the values."""
        shares = torch.softmax(out, 1)
        return shares * (self.centres.t() - torch.mm(shares, self.centres)) * dq
