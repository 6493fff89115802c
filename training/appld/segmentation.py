"""Segmentation of demonstrations into contexts for APPLD (appld.py).

Changepoints delimit segments of uniform driving in uniform surroundings. Similar segments form one
context.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, NamedTuple

import numpy as np
import scipy

from applr_ros1.policy.observation import layout_of, without_gaps
from applr_ros1.robots import Robot
from applr_ros1.stack.simulated import CONTROL_PERIOD
from training.appld.demonstration import Demonstration, policy_scans

FEATURES = ("speed", "turning", "ahead", "near side", "far side")
SMOOTHED = 15  # number of instants over which a feature is averaged
MOST_CONTEXTS = 4  # largest number of contexts
PENALTY = 3.0  # cost of a changepoint; a higher cost gives fewer segments
SHORTEST = 1.5  # minimum duration of a segment [s]
# Bearing and width of the sectors of the scan ahead, to the right and to the left [rad]
AHEAD = (0.0, math.radians(45.0))
RIGHT = (-1.311, math.radians(75.0))
LEFT = (1.311, math.radians(75.0))


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


def features(demonstration: Demonstration, robot: Robot) -> np.ndarray:
    """Return FEATURES (n, 5): |v|, |w|, and the free distances ahead and beside the robot.

    The two distances beside the robot are sorted, so that a wall on either side is the same.
    """
    import pandas  # slow to import; --help does not need it

    # Beyond its cap, a range counts as open space, as it does for a policy.
    layout = layout_of(robot)
    scans = [without_gaps(scan, layout) for scan in policy_scans(demonstration, robot)]
    ranges = np.array(scans, np.float64).clip(0.0, layout.range_cap)
    free_distances = []
    for bearing, width in (AHEAD, RIGHT, LEFT):
        free_distances.append(ranges[:, layout.sector(bearing, width)].min(axis=1))
    ahead, right, left = free_distances

    speeds = np.abs(demonstration.commands.twist)
    sides = np.sort(np.column_stack([right, left]), axis=1)
    raw_features = np.column_stack([speeds, ahead, sides])
    windows = pandas.DataFrame(raw_features).rolling(SMOOTHED, center=True, min_periods=1)
    return np.asarray(windows.mean())


def find(demonstrations: List[Demonstration], robot: Robot) -> Contexts:
    """Return the contexts of one or more demonstrations.

    Changepoints minimise the squared error about each segment's mean features plus a penalty per
    changepoint. This is the likelihood of normal features with the penalty of BIC, and replaces the
    Bayesian CHAMP of the APPLD paper. Ward's method then clusters the segments into at most
    MOST_CONTEXTS contexts.
    """
    import pandas

    # All features count equally, whatever their unit.
    by_drive = [features(demonstration, robot) for demonstration in demonstrations]
    all_features = np.concatenate(by_drive)
    mean_features = all_features.mean(axis=0)
    spread = np.maximum(all_features.std(axis=0), 1e-3)

    # Segments with their mean features; the context is not known yet.
    segments: List[Segment] = []
    segment_means = []
    for demonstration_index, drive_features in enumerate(by_drive):
        scaled_features = (drive_features - mean_features) / spread
        first_instant = 0
        for end_instant in _cut(scaled_features):
            segments.append(Segment(demonstration_index, first_instant, end_instant, 0))
            segment_means.append(scaled_features[first_instant:end_instant].mean(axis=0))
            first_instant = end_instant

    labels = np.arange(len(segments))
    if len(segments) > MOST_CONTEXTS:
        cluster_tree = scipy.cluster.hierarchy.linkage(np.array(segment_means), "ward")
        labels = scipy.cluster.hierarchy.fcluster(cluster_tree, MOST_CONTEXTS, "maxclust")
    contexts = pandas.factorize(labels)[0].tolist()  # numbered by first appearance
    labelled = []
    lengths = []
    for segment, context in zip(segments, contexts):
        labelled.append(segment._replace(context=context))
        lengths.append(segment.last - segment.first)

    by_context = pandas.DataFrame(all_features).groupby(np.repeat(contexts, lengths))
    context_means = by_context.mean().to_numpy()
    return Contexts(labelled, names_of(context_means), context_means)


def _cut(scaled: np.ndarray) -> List[int]:
    """Return the ends of the segments of scaled features (n, 5); the last one is n."""
    import ruptures  # slow, because it imports scipy.signal

    shortest = int(SHORTEST / CONTROL_PERIOD)
    if len(scaled) < 2 * shortest:
        return [len(scaled)]  # ruptures refuses what it cannot cut.
    changepoint_cost = PENALTY * scaled.shape[1] * np.log(len(scaled))
    search = ruptures.KernelCPD("linear", min_size=shortest).fit(scaled)
    return list(map(int, search.predict(pen=changepoint_cost)))


def names_of(means: np.ndarray) -> List[str]:
    """Return a number and distinguishing words for each context, such as "1 open, wide, fast"."""
    usual_speed, usual_turning, usual_ahead, usual_near_side, _ = np.median(means, axis=0)
    names = []
    for number, (speed, turning, ahead, near_side, _) in enumerate(means):
        words = [
            "open" if ahead > usual_ahead else "close ahead",
            "narrow" if near_side < usual_near_side else "wide",
            "fast" if speed > usual_speed else "slow",
        ]
        if turning > usual_turning:
            words.append("turning")
        names.append(f"{number + 1} {', '.join(words)}")
    return names
