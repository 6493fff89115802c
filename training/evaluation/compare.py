"""One method compared with another over worlds: which costs less, how much less, and how sure that is.

The world is the unit, since trials of one world resemble each other. A method is given by its mean cost in each world,
such as the time of a trial, or what a failed one counts as [s].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, Optional, Tuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.05  # of the tests
RESAMPLES = 2000  # of the bootstrap
EXCHANGES = 19999  # of the test: all ways to exchange two methods where they are at most so many, else random ones


class Estimate(NamedTuple):
    """A value with the ends of its 95 % interval, which are nan where the sample gives none."""

    value: float
    low: float
    high: float


class Comparison(NamedTuple):
    """A method beside another.

    Attributes:
        worlds: number of worlds.
        difference: mean over worlds of its score less the other's [s]; negative where it is faster.
        gain: share of the other's mean score that it saves.
        p: of the two-sided test of the difference by exchanging the two methods in worlds; nan below two worlds.
    """

    worlds: int
    difference: Estimate
    gain: Estimate
    p: float

    def better(self, level: float) -> bool:
        """Return whether the method is significantly better than the other."""
        return self.difference.value < 0.0 and self.p < level

    def line(self, level: float) -> str:
        """Return whether the method is better than the other, how much it saves, and whether the test can tell."""
        value, low, high = self.difference
        if value <= 0.0:
            value, low, high = -value, -high, -low
        word = "less" if self.difference.value <= 0.0 else "more"
        how = f"{value:.1f} s {word} per course ({low:.1f} to {high:.1f}, p = {self.p:.2g})"
        unsure = "" if self.p < level else ": too few courses to tell"
        return f"better: {'yes' if self.better(level) else 'no'}, {how}{unsure}"


def compare(scores: ArrayLike, others: ArrayLike) -> Comparison:
    """Compare a method's mean scores (n,) [s] in n worlds with another's there; their trials have the same seeds."""
    ours, theirs = np.asarray(scores, dtype=np.float64), np.asarray(others, dtype=np.float64)
    difference = ours - theirs
    return Comparison(len(difference), over_worlds(difference), over_worlds(-difference, theirs), exchanged(difference))


def exchanged(difference: np.ndarray, alternative: str = "two-sided") -> float:
    """Return p of the test by exchanging two methods in worlds, or in trials; nan of fewer than two.

    Args:
        difference: (n,) of the two in each.
        alternative: as scipy names it; greater: the first is larger.
    """
    if len(difference) < 2:
        return math.nan
    rng = np.random.default_rng(0)
    how = {"permutation_type": "samples", "n_resamples": EXCHANGES, "vectorized": True, "alternative": alternative}
    return float(scipy.stats.permutation_test((difference,), np.mean, random_state=rng, **how).pvalue)


def clearly_worse(costs: np.ndarray, best: np.ndarray) -> bool:
    """Return whether costs (n,) are significantly larger than the best ones (n,) of the same n trials."""
    return exchanged(costs - best, "greater") < LEVEL


def over_worlds(totals: ArrayLike, counts: Optional[ArrayLike] = None) -> Estimate:
    """Return the sum of `totals` (n,) over that of `counts` (n,), with its interval by bootstrap over the n worlds.

    Without counts it is the mean of the totals. Worlds whose count is 0 are left out.
    """
    above = np.asarray(totals, dtype=np.float64)
    below = np.ones(len(above)) if counts is None else np.asarray(counts, dtype=np.float64)
    above, below = above[below != 0.0], below[below != 0.0]
    value = float(_ratio(above, below)) if len(above) else math.nan
    if len(above) < 2:
        return Estimate(value, math.nan, math.nan)
    how = {"paired": True, "vectorized": True, "n_resamples": RESAMPLES, "method": "percentile"}
    found = scipy.stats.bootstrap((above, below), _ratio, random_state=np.random.default_rng(0), **how)
    return Estimate(value, *map(float, found.confidence_interval))


def _ratio(totals: np.ndarray, counts: np.ndarray, axis: int = -1) -> np.ndarray:
    return totals.sum(axis=axis) / counts.sum(axis=axis)


def rate(flags: pd.Series, world: pd.Series) -> Estimate:
    """Return the share of True among trials (n,), whose worlds are given, with its 95 % interval.

    The interval is Wilson's for as many independent trials as have the variance of this share over the worlds (at most
    as many as there are): trials of a world resemble each other.
    """
    by_world = flags.astype(float).groupby(world.to_numpy(), sort=False)
    sums, counts = by_world.sum().to_numpy(), by_world.count().to_numpy()
    n, worlds = float(counts.sum()), len(counts)
    share = float(sums.sum() / n)
    spread = float(np.square(sums - share * counts).sum()) * worlds / max(1, worlds - 1) / n**2
    return Estimate(share, *wilson(share, min(n, share * (1.0 - share) / spread) if spread > 0.0 else n))


def wilson(share: float, n: float) -> Tuple[float, float]:
    """Return Wilson's 95 % interval of a share of n independent trials, which need not be a whole number."""
    z = float(scipy.stats.norm.ppf(0.975))
    middle, half = share + z * z / (2.0 * n), z * math.sqrt(share * (1.0 - share) / n + (z / (2.0 * n)) ** 2)
    return max(0.0, middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n)  # not -0 by rounding
