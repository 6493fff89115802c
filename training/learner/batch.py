"""Joins data and algorithm: what the replay drew becomes the tensors that TD3 learns from. learner.py calls it."""

from __future__ import annotations

import numpy as np
import torch

from training.replay.buffer import Replay
from training.td3.td3 import Batch


def draw_batch(
    replay: Replay,
    rng: np.random.Generator,
    size: int,
    n_step: int,
    gamma: float,
    device: torch.device = torch.device("cpu"),
    mirror: bool = False,
) -> Batch:
    """A batch for TD3.update, smoothing noise included: all randomness of a gradient step comes from `rng`.

    Args:
        replay: where the transitions are drawn, uniformly.
        rng: source of the rows, then of the noise.
        size: transitions of the batch.
        n_step: steps of the returns.
        gamma: discount per decision.
        device: where the tensors go.
        mirror: half of the transitions mirrored left for right (Replay.sample).
    """
    sample = replay.sample(rng, size, n_step, gamma, mirror)
    noise = rng.standard_normal((size, replay.layout.action), dtype=np.float32)
    step = replay.layout.step
    return Batch(
        _observation(sample.scan, sample.rest, step, device),
        _tensor(sample.action, device),
        _tensor(sample.reward, device),
        _tensor(sample.discount, device),
        _observation(sample.next_scan, sample.next_rest, step, device),
        _tensor(noise, device),
    )


def _observation(scan: np.ndarray, rest: np.ndarray, step: float, device: torch.device) -> torch.Tensor:
    """Observation (B, n) of stored scans (B, beams) in units of `step` above -1, and the rest (B, k) as it is."""
    beams, others = _tensor(scan, device), _tensor(rest, device)
    return torch.cat((beams.mul_(step).sub_(1.0), others), 1) if beams.shape[1] else others


def _tensor(array: np.ndarray, device: torch.device) -> torch.Tensor:
    """A numpy array as a float32 tensor on the device (bytes travel as bytes and become floats there)."""
    tensor = torch.from_numpy(array)
    if device.type == "cuda":
        tensor = tensor.pin_memory().to(device, non_blocking=True)
    return tensor.to(torch.float32)
