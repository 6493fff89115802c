"""One method compared with another over worlds: which needs less time, how much less, and how sure that is.

The report, ./applr tune and the race of the page ask it. The world is the unit, since trials of one world resemble each
other. A method is given by its mean score in each world: the time of a trial, or what a failed one counts as [s].
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

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
        ahead: in how many of them the method has the smaller score.
        difference: mean over worlds of its score less the other's [s]; negative where it is faster.
        gain: share of the other's mean score that it saves.
        p: of the two-sided test of the difference by exchanging the two methods in worlds; nan below two worlds.
    """

    worlds: int
    ahead: int
    difference: Estimate
    gain: Estimate
    p: float

    def sentence(self, method: str, other: str) -> str:
        """How much less time the method takes than the other, without a full stop."""
        gain, low, high = (100.0 * value for value in self.gain)
        text = f"{method} took {abs(gain):.1f} % {'less' if gain >= 0.0 else 'more'} time than {other}"
        if not math.isfinite(low):
            return text
        if low <= 0.0 <= high:
            interval = f"95 % interval: {high:.1f} % less to {-low:.1f} % more"
            return f"{method} cannot be told from {other} in time ({interval})"
        near, far = sorted((abs(low), abs(high)))
        return f"{text} (95 % interval {near:.1f} to {far:.1f} %)"


def compare(scores: ArrayLike, others: ArrayLike) -> Comparison:
    """Compares a method's mean scores (n,) [s] in n worlds with another's there; their trials have the same seeds."""
    ours, theirs = np.asarray(scores, dtype=np.float64), np.asarray(others, dtype=np.float64)
    difference, p = ours - theirs, math.nan
    if len(difference) > 1:
        p = stats.permutation_test(
            (difference,),
            np.mean,
            permutation_type="samples",
            n_resamples=EXCHANGES,
            vectorized=True,
            random_state=np.random.default_rng(0),
        ).pvalue
    ahead = int((difference < 0.0).sum())
    return Comparison(len(difference), ahead, over_worlds(difference), over_worlds(-difference, theirs), float(p))


def over_worlds(totals: ArrayLike, counts: Optional[ArrayLike] = None) -> Estimate:
    """The sum of `totals` (n,) over that of `counts` (n,), with its interval by bootstrap over the n worlds.

    Without counts it is the mean of the totals.
    """
    above = np.asarray(totals, dtype=np.float64)
    below = np.ones(len(above)) if counts is None else np.asarray(counts, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(above.sum() / below.sum())
        if len(above) < 2:
            return Estimate(value, math.nan, math.nan)
        picks = np.random.default_rng(0).integers(0, len(above), size=(RESAMPLES, len(above)))
        values = above[picks].sum(axis=1) / below[picks].sum(axis=1)
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, (0.025, 0.975)) if len(values) else (math.nan, math.nan)
    return Estimate(value, float(low), float(high))
