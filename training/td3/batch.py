"""The transitions of one gradient step. gorila/batch.py draws them from the replay, td3.py learns from them."""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass
class Batch:
    """The transitions of one update, as tensors on the learner's device.

    Attributes:
        observation: (B, n).
        action: (B, m) in [-1, 1].
        reward: (B,) sum of k discounted rewards.
        discount: (B,) gamma^k; 0 past a terminal state.
        next_observation: (B, n) k steps later.
        noise: (B, m) standard normal, for the smoothing of target actions.
    """

    observation: torch.Tensor
    action: torch.Tensor
    reward: torch.Tensor
    discount: torch.Tensor
    next_observation: torch.Tensor
    noise: torch.Tensor
