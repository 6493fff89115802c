"""Segmentation of demonstrations into contexts for APPLD (appld.py).

Changepoints delimit segments of uniform driving in uniform surroundings. Similar segments form one context.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, NamedTuple

import numpy as np
import scipy

from applr_ros1.drives.drive import Drive
from applr_ros1.policy.observation import layout_of
from applr_ros1.robots import Robot
from training.appld.demonstration import policy_scans
from training.env.episode import CONTROL_PERIOD

FEATURES = ("speed", "turning", "ahead", "near side", "far side")
SMOOTHED = 15  # number of instants over which a feature is averaged
SHORTEST = 1.5  # minimum duration of a segment [s]


class Segment(NamedTuple):
    """Instants [first, last) of a demonstration, and their context."""

    demonstration: int
    first: int
    last: int
    context: int


@dataclass
class Contexts:
    """Contexts of demonstrations.

    Attributes:
        segments: Segments in the order of driving.
        names: (k,) names of the contexts.
        means: (k, 5) means of FEATURES in each context [m/s, rad/s, m, m, m].
    """

    segments: List[Segment]
    names: List[str]
    means: np.ndarray


def features(demonstration: Drive, robot: Robot) -> np.ndarray:
    """Return FEATURES (n, 5): |v|, |w|, free distance ahead, smaller and larger free distance beside the robot."""
    import pandas  # slow to import; --help does not need it

    assert demonstration.commands is not None
    layout = layout_of(robot)
    cap = layout.range_cap  # range beyond which space counts as open [m]
    ranges = np.nan_to_num(
        np.asarray(policy_scans(demonstration, robot), np.float64), nan=cap, posinf=cap, neginf=0.0
    )
    ranges = np.minimum(ranges, cap)
    ahead, right, left = (
        ranges[:, layout.sector(bearing, math.radians(width))].min(axis=1)
        for bearing, width in ((0.0, 45.0), (-1.311, 75.0), (1.311, 75.0))
    )
    speeds = np.abs(demonstration.commands.twist)
    sides = np.sort(np.column_stack([right, left]), axis=1)
    raw = np.column_stack([speeds, ahead, sides])
    return np.asarray(pandas.DataFrame(raw).rolling(SMOOTHED, center=True, min_periods=1).mean())


def find(
    demonstrations: List[Drive], robot: Robot, most: int = 4, penalty: float = 3.0
) -> Contexts:
    """Return the contexts of one or more demonstrations.

    Changepoints minimise the squared error about each segment's mean features plus a penalty per changepoint. This is
    the likelihood of normal features with the penalty of BIC, and replaces the Bayesian CHAMP of the APPLD paper.
    Ward's method then clusters the segments into at most `most` contexts. If `most` is 0, every segment is a context of
    its own, as in the APPLD paper.
    """
    import pandas

    seen = [features(demonstration, robot) for demonstration in demonstrations]
    every = np.concatenate(seen)
    mean, spread = every.mean(axis=0), np.maximum(every.std(axis=0), 1e-3)
    scaled = [(f - mean) / spread for f in seen]
    cuts = [_cut(f, penalty) for f in scaled]
    spans = [
        (number, a, b) for number, ends in enumerate(cuts) for a, b in zip([0] + ends[:-1], ends)
    ]
    means = np.array([scaled[number][a:b].mean(axis=0) for number, a, b in spans])
    labels = np.arange(len(spans))
    if most and len(spans) > most:
        labels = scipy.cluster.hierarchy.fcluster(
            scipy.cluster.hierarchy.linkage(means, "ward"), most, "maxclust"
        )
    labels = pandas.factorize(labels)[0]  # contexts numbered by first appearance
    own = (
        pandas.DataFrame(every)
        .groupby(np.repeat(labels, [b - a for _, a, b in spans]))
        .mean()
        .to_numpy()
    )
    return Contexts(
        [Segment(*span, int(label)) for span, label in zip(spans, labels)], _names(own), own
    )


def _cut(scaled: np.ndarray, penalty: float) -> List[int]:
    """Return the ends of the segments; the last one is len(scaled)."""
    import ruptures  # slow, because it imports scipy.signal

    shortest = int(SHORTEST / CONTROL_PERIOD)
    if len(scaled) < 2 * shortest:
        return [len(scaled)]
    price = penalty * scaled.shape[1] * np.log(len(scaled))
    return [
        int(end)
        for end in ruptures.KernelCPD("linear", min_size=shortest).fit(scaled).predict(pen=price)
    ]


def _names(means: np.ndarray) -> List[str]:
    """Return a number and distinguishing words for each context, such as "1 open, wide, fast"."""
    middle = np.median(means, axis=0)
    names = []
    for number, (speed, turning, ahead, near, _) in enumerate(means):
        words = [
            "open" if ahead > middle[2] else "close ahead",
            "narrow" if near < middle[3] else "wide",
            "fast" if speed > middle[0] else "slow",
        ] + (["turning"] if turning > middle[1] else [])
        names.append(f"{number + 1} {', '.join(words)}")
    return names
