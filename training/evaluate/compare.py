"""Comparison of two methods over worlds: which one costs less, by how much, and how significantly.

The world is the statistical unit, because trials in one world resemble each other. A method is represented by its mean
cost in each world. The cost of a trial is, for example, its time, or a fixed time if it failed [s].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, Optional, Tuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from applr_ros1.common.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.05  # significance level of the tests
RESAMPLES = 2000  # number of bootstrap resamples
# Smallest number of worlds in which the test can be significant: of their 2^n sign flips, at least two (the observed
# signs and their opposites) are as extreme as the observed difference.
FEWEST_WORLDS = 1 + math.ceil(-math.log2(LEVEL))
EXCHANGES = 19999  # largest number of sign flips in a test: all of them if there are fewer, otherwise random ones


class Estimate(NamedTuple):
    """A value, and the ends of its 95 % confidence interval; they are NaN if the sample is too small."""

    value: float
    low: float
    high: float


class Comparison(NamedTuple):
    """Comparison of a method with another.

    Attributes:
        worlds: Number of worlds.
        difference: Mean over worlds of the method's score minus the other's [s]; negative if the method is faster.
        gain: Time saved by the method, as a share of the other method's mean score.
        p: p-value of the two-sided paired sign-flip permutation test over worlds; NaN for fewer than two worlds.
    """

    worlds: int
    difference: Estimate
    gain: Estimate
    p: float

    def better(self, level: float) -> bool:
        """Return whether the method is significantly better than the other."""
        return self.difference.value < 0.0 and self.p < level

    def line(self, level: float) -> str:
        """Return a message: whether the method is better, by how much, and whether the test can decide."""
        value, low, high = self.difference
        if value <= 0.0:
            value, low, high = -value, -high, -low
        word = "less" if self.difference.value <= 0.0 else "more"
        how = f"{value:.1f} s {word} per course ({low:.1f} to {high:.1f}, p = {self.p:.2g})"
        unsure = "" if self.p < level else ": too few courses to tell"
        return f"better: {'yes' if self.better(level) else 'no'}, {how}{unsure}"


def compare(scores: ArrayLike, others: ArrayLike) -> Comparison:
    """Compare the mean scores (n,) [s] of two methods in n worlds. Their trials must have the same seeds."""
    ours, theirs = np.asarray(scores, dtype=np.float64), np.asarray(others, dtype=np.float64)
    difference = ours - theirs
    return Comparison(len(difference), over_worlds(difference), over_worlds(-difference, theirs), exchanged(difference))


def exchanged(difference: np.ndarray, alternative: str = "two-sided") -> float:
    """Return the p-value of a paired sign-flip permutation test over worlds or trials; NaN for fewer than two.

    Args:
        difference: Differences (n,) of the two methods, one per world or trial.
        alternative: Alternative hypothesis in scipy's terms; with "greater", the first method's values are larger.
    """
    if len(difference) < 2:
        return math.nan
    rng = np.random.default_rng(0)
    how = {"permutation_type": "samples", "n_resamples": EXCHANGES, "vectorized": True, "alternative": alternative}
    return float(scipy.stats.permutation_test((difference,), np.mean, random_state=rng, **how).pvalue)


def clearly_worse(costs: np.ndarray, best: np.ndarray) -> bool:
    """Return whether costs (n,) are significantly larger than the best costs (n,) in the same n trials."""
    return exchanged(costs - best, "greater") < LEVEL


def over_worlds(totals: ArrayLike, counts: Optional[ArrayLike] = None) -> Estimate:
    """Return the sum of `totals` (n,) divided by the sum of `counts` (n,), with a bootstrap interval over n worlds.

    Without counts, return the mean of the totals. Worlds whose count is 0 are left out.
    """
    above = np.asarray(totals, dtype=np.float64)
    below = np.ones(len(above)) if counts is None else np.asarray(counts, dtype=np.float64)
    above, below = above[below != 0.0], below[below != 0.0]
    value = float(_ratio(above, below)) if len(above) else math.nan
    if len(above) < 2:
        return Estimate(value, math.nan, math.nan)
    how = {"paired": True, "vectorized": True, "n_resamples": RESAMPLES, "method": "percentile"}
    resampled = scipy.stats.bootstrap((above, below), _ratio, random_state=np.random.default_rng(0), **how)
    return Estimate(value, *map(float, resampled.confidence_interval))


def _ratio(totals: Array, counts: Array, axis: int = -1) -> Array:
    return np.asarray(totals.sum(axis=axis) / counts.sum(axis=axis))


def rate(flags: pd.Series, world: pd.Series) -> Estimate:
    """Return the share of True among trials (n,) in the given worlds (n,), with its 95 % interval.

    Trials in one world resemble each other. Wilson's interval is therefore computed for an effective number of
    independent trials, at most n, for which the share would have the variance observed between the worlds.
    """
    by_world = flags.astype(float).groupby(world.to_numpy(), sort=False)
    sums, counts = by_world.sum().to_numpy(), by_world.count().to_numpy()
    n, worlds = float(counts.sum()), len(counts)
    share = float(sums.sum() / n)
    spread = float(np.square(sums - share * counts).sum()) * worlds / max(1, worlds - 1) / n**2
    return Estimate(share, *wilson(share, min(n, share * (1.0 - share) / spread) if spread > 0.0 else n))


def wilson(share: float, n: float) -> Tuple[float, float]:
    """Return Wilson's 95 % interval of a share of n independent trials; n may be fractional."""
    z = float(scipy.stats.norm.ppf(0.975))
    middle, half = share + z * z / (2.0 * n), z * math.sqrt(share * (1.0 - share) / n + (z / (2.0 * n)) ** 2)
    return max(0.0, middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n)  # max avoids a rounded -0
