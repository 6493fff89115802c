"""APPLD's context classifier: a small network from the scan of an observation to the context.

The command trains the network with torch. ContextPolicy (applr_ros1/policy/actor.py) runs it with
numpy.
"""

from __future__ import annotations

from typing import Dict, Optional, Tuple

import numpy as np

from applr_ros1.policy.actor import forward, layers_of
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import LAYOUT, scaled, without_gaps

HIDDEN = 64  # number of hidden units
STEPS = 500  # number of gradient steps
BATCH = 128  # number of scans per gradient step
SHIFT = 0.157  # largest random rotation of a scan [rad]: 9 degrees
NOISE = 0.02  # standard deviation of the noise on ranges [m]
# Number of consecutive instants held out together, because consecutive scans are nearly equal
BLOCK = 40

ClassifierWeights = Dict[str, np.ndarray]


def inputs(ranges: np.ndarray, layout: Layout = LAYOUT) -> np.ndarray:
    """Return scans (n, beams) [m] as a policy gets them, in [-1, 1].

    Raises:
        ObservationError: No beam of a scan is valid.
    """
    return np.array([scaled(without_gaps(scan, layout), layout) for scan in ranges])


def train(
    scans: np.ndarray, labels: np.ndarray, contexts: int, seed: int = 0, layout: Layout = LAYOUT
) -> Tuple[ClassifierWeights, Dict[str, Optional[float]]]:
    """Train the network with augmented scans (mirrored, rotated, noisy).

    Args:
        scans: (n, beams) scans as returned by inputs().
        labels: (n,) context of each scan.
        contexts: Number of contexts.
        seed: Seed of weights, batches and augmentation.
        layout: Beams of the scans.

    Returns:
        The weights for policy/actor.py, and the quality. "accuracy": share of correct labels,
        training data included. "held_out": accuracy on every fifth BLOCK of a network trained on
        the others, None if there are too few. "instants": number of instants.
    """
    # The accuracy on scans that the network has learnt from says nothing about others.
    is_held_out = np.arange(len(labels)) // BLOCK % 5 == 4
    held_out = None
    if is_held_out.any() and not is_held_out.all() and contexts > 1:
        probe_weights = fit(scans[~is_held_out], labels[~is_held_out], contexts, seed, layout)
        held_out = accuracy(probe_weights, scans[is_held_out], labels[is_held_out])
    weights = fit(scans, labels, contexts, seed, layout)
    return weights, {
        "accuracy": accuracy(weights, scans, labels),
        "held_out": held_out,
        "instants": len(labels),
    }


def fit(
    scans: np.ndarray, labels: np.ndarray, contexts: int, seed: int, layout: Layout
) -> ClassifierWeights:
    """Return the weights of a network trained on scans (n, beams) with labels (n,)."""
    import torch  # takes seconds; --help does not import it

    from training.train.td3.td3 import MLP

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # Several threads are slower for such a small network.
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = MLP(layout.beams, [HIDDEN], contexts)
    # A rare context counts as much as a frequent one.
    counts = np.maximum(1, np.bincount(labels, minlength=contexts))
    balance = torch.tensor(len(labels) / counts / contexts, dtype=torch.float32)
    criterion = torch.nn.CrossEntropyLoss(
        weight=balance,
        label_smoothing=0.05,
    )
    optimiser = torch.optim.AdamW(network.parameters(), lr=1e-3, weight_decay=1e-2)
    for _ in range(STEPS):
        batch_rows = rng.integers(0, len(labels), BATCH)
        scan_batch = torch.from_numpy(_varied(scans[batch_rows], rng, layout))
        loss = criterion(network(scan_batch), torch.from_numpy(labels[batch_rows]))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    torch.set_num_threads(threads)
    weights = {}
    for weight_name, tensor in network.state_dict().items():
        weights[weight_name] = tensor.numpy().copy()
    return weights


def _varied(scans: np.ndarray, rng: np.random.Generator, layout: Layout) -> np.ndarray:
    """Return scans (n, beams), half of them mirrored, each rotated by up to SHIFT, with noise."""
    # Indices (n, beams) of the beams to take; at the ends, the last beam is repeated.
    last_beam = layout.beams - 1
    largest_shift = round(SHIFT / layout.step)
    shifts = rng.integers(-largest_shift, largest_shift + 1, (len(scans), 1))
    shifted_beams = np.arange(layout.beams) + shifts
    beams = np.clip(shifted_beams, 0, last_beam)
    is_mirrored = rng.random((len(scans), 1)) < 0.5
    beams = np.where(is_mirrored, last_beam - beams, beams)
    moved_scans = np.take_along_axis(scans, beams, axis=1)

    deviation = np.float32(NOISE * 2.0 / layout.range_cap)  # in the units of inputs()
    noise = rng.standard_normal(scans.shape, dtype=np.float32) * deviation
    noisy_scans = np.clip(moved_scans + noise, -1.0, 1.0)
    return np.asarray(noisy_scans, np.float32)


def accuracy(weights: ClassifierWeights, scans: np.ndarray, labels: np.ndarray) -> float:
    """Return the share of scans (n, beams) whose label (n,) a network finds."""
    scores = forward(layers_of(weights), scans)
    found_labels = np.argmax(scores, axis=1)
    share = float((found_labels == labels).mean())
    return round(share, 4)
