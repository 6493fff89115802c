"""Whether something is better: the one paired comparison of all attempts.

What is compared drives the same worlds with the same seeds. A drive costs its time, or a fixed cost
if it did not arrive cleanly (drives/outcome.py). A paired test decides: of policies and sets
(evaluate), of sets in a race (tune), and of a remedy (why). The world is the statistical unit,
because trials in one world resemble each other: a method is represented by its mean cost in each
world. These rules stay apart:

- A change helps a robot on open floor (check) if all courses are driven cleanly: the robot fails
  there as it is, and nothing in that simulator is random.
- The policy with the lowest mean score is kept (train): this only chooses what is judged, in other
  worlds.
- A parameter goes back to its default (tune) if that costs next to nothing: the fewest changes are
  wanted where no test would tell.
- A remedy for many stops (why) may make none of them worse: a few drives at each are no test.
- The report of an evaluation also counts worlds by the paper's test (Welch's, within a world), and
  the page of tune says by its interval whether a parameter saves something: nothing is chosen by
  either.
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
# Smallest number of worlds in which the test can be significant: of their 2^n sign flips, at least
# two (the observed signs and their opposites) are as extreme as the observed difference.
FEWEST_WORLDS = 1 + math.ceil(-math.log2(LEVEL))
RESAMPLES = 2000  # number of bootstrap resamples
# Largest number of sign flips in a test: all if there are fewer, else random ones
EXCHANGES = 19999


class Estimate(NamedTuple):
    """A value and the ends of its 95 % confidence interval, NaN if the sample is too small."""

    value: float
    low: float
    high: float


class Comparison(NamedTuple):
    """Comparison of a method with another.

    Attributes:
        worlds: Number of worlds.
        difference: Mean over worlds of the method's score minus the other's [s]; negative if the
            method is faster.
        gain: Time saved by the method, as a share of the other method's mean score.
        p: p-value of the two-sided paired sign-flip permutation test over worlds; NaN for fewer
            than two worlds.
    """

    worlds: int
    difference: Estimate
    gain: Estimate
    p: float

    def better(self, level: float) -> bool:
        """Return whether the method is significantly better than the other."""
        return self.difference.value < 0.0 and self.p < level


def corrected(test_count: int) -> float:
    """Return the significance level for each of several tests, by Bonferroni's correction.

    Each rival, and each look at more drives, is another chance to be better by luck.
    """
    return LEVEL / max(test_count, 1)


def compare(scores: ArrayLike, others: ArrayLike) -> Comparison:
    """Compare the mean scores (n,) [s] of two methods in n worlds, driven with the same seeds."""
    method_scores = np.asarray(scores, dtype=np.float64)
    other_scores = np.asarray(others, dtype=np.float64)
    difference = method_scores - other_scores
    return Comparison(
        worlds=len(difference),
        difference=over_worlds(difference),
        gain=over_worlds(-difference, other_scores),
        p=exchanged(difference),
    )


def exchanged(difference: np.ndarray, alternative: str = "two-sided") -> float:
    """Return the p-value of a paired sign-flip permutation test; NaN for fewer than two worlds.

    Args:
        difference: Differences (n,) of the two methods, one per world or trial.
        alternative: Alternative hypothesis in scipy's terms; with "greater", the first method's
            values are larger.
    """
    if len(difference) < 2:
        return math.nan
    # The seed is fixed, so that a report written again has the same figures.
    # With "samples", scipy exchanges the values of a pair: it flips the sign of the difference.
    test = scipy.stats.permutation_test(
        (difference,),
        np.mean,
        permutation_type="samples",
        n_resamples=EXCHANGES,
        vectorized=True,
        alternative=alternative,
        random_state=np.random.default_rng(0),
    )
    return float(test.pvalue)


def clearly_worse(costs: np.ndarray, best: np.ndarray, level: float = LEVEL) -> bool:
    """Return whether costs (n,) are significantly larger than the best costs of the same trials."""
    return exchanged(costs - best, "greater") < level


def over_worlds(totals: ArrayLike, counts: Optional[ArrayLike] = None) -> Estimate:
    """Return the sum of `totals` (n,) divided by the sum of `counts` (n,), both over n worlds.

    The interval is a bootstrap over the worlds. Without counts, return the mean of the totals.
    Worlds whose count is 0 are left out.
    """
    numerators = np.asarray(totals, dtype=np.float64)
    if counts is None:
        denominators = np.ones(len(numerators))
    else:
        denominators = np.asarray(counts, dtype=np.float64)
    is_counted = denominators != 0.0
    numerators, denominators = numerators[is_counted], denominators[is_counted]

    value = math.nan
    if len(numerators):
        value = float(_ratio(numerators, denominators))
    if len(numerators) < 2:
        return Estimate(value, math.nan, math.nan)
    resampled = scipy.stats.bootstrap(
        (numerators, denominators),
        _ratio,
        paired=True,
        vectorized=True,
        n_resamples=RESAMPLES,
        method="percentile",
        random_state=np.random.default_rng(0),
    )
    low, high = resampled.confidence_interval
    return Estimate(value, float(low), float(high))


def _ratio(totals: Array, counts: Array, axis: int = -1) -> Array:
    return np.asarray(totals.sum(axis=axis) / counts.sum(axis=axis))


def rate(flags: pd.Series, world: pd.Series) -> Estimate:
    """Return the share of True among trials (n,) in the given worlds (n,), with its 95 % interval.

    Trials in one world resemble each other. Wilson's interval is therefore computed for an
    effective number of independent trials, at most n, for which the share would have the variance
    observed between the worlds.
    """
    by_world = flags.astype(float).groupby(world.to_numpy(), sort=False)
    sums = by_world.sum().to_numpy()
    counts = by_world.count().to_numpy()
    n = float(counts.sum())
    worlds = len(counts)
    share = float(sums.sum() / n)

    # Variance of a share estimated from clusters of unequal size; binomial if the trials are
    # independent.
    squares = float(np.square(sums - share * counts).sum())
    variance = squares * worlds / max(1, worlds - 1) / n**2
    effective = n
    if variance > 0.0:
        effective = min(n, share * (1.0 - share) / variance)
    low, high = wilson(share, effective)
    return Estimate(share, low, high)


def wilson(share: float, n: float) -> Tuple[float, float]:
    """Return Wilson's 95 % interval of a share of n independent trials; n may be fractional."""
    z = float(scipy.stats.norm.ppf(0.975))
    middle = share + z * z / (2.0 * n)
    variance = share * (1.0 - share) / n
    half = z * math.sqrt(variance + (z / (2.0 * n)) ** 2)
    scale = 1.0 + z * z / n
    low = max(0.0, middle - half) / scale  # max avoids a rounded -0.
    return low, (middle + half) / scale
