"""The report's statistics: Welch tests per world with and without Holm's correction, and intervals.

What compares methods over worlds takes the world as the unit: trials of one world are no independent sample.
"""

from __future__ import annotations

import math
import warnings
from typing import Callable, List, NamedTuple, Sequence, Tuple

import numpy as np
from scipy import stats

from training.report.data import Cell, Results

LEVEL = 0.05
RESAMPLES = 2000
SIGNS = 19999  # random draws of signs in the paired test


class Verdict(NamedTuple):
    """Which of two methods is faster in one world, and how sure that is.

    Attributes:
        world: name of the world.
        sign: -1 if the rival is faster, +1 if the baseline is.
        p: of Welch's test; nan where it cannot be tested because a side has fewer than two successes.
    """

    world: str
    sign: int
    p: float


def welch(results: Results, method: str, worlds: List[str], other: str = "") -> List[Verdict]:
    """Two-sided Welch test of the successful trials' times in each world, method against the other or the baseline."""
    found, other = [], other or results.baseline
    for world in results.both(method, worlds, other):
        ours, theirs = results.cells[method][world].times, results.cells[other][world].times
        sign = int(np.sign(ours.mean() - theirs.mean())) if len(ours) and len(theirs) else 0
        found.append(Verdict(world, sign, welch_p(ours, theirs)))
    return found


def welch_p(a: np.ndarray, b: np.ndarray) -> float:
    """The p-value of Welch's t-test; nan with fewer than two values on a side; 0 or 1 where neither side varies."""
    if len(a) < 2 or len(b) < 2:
        return float("nan")
    if np.ptp(a) == 0.0 and np.ptp(b) == 0.0:  # a standard deviation need not be 0 then
        return float(a[0] == b[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # scipy's, where a side hardly varies
        return float(stats.ttest_ind(a, b, equal_var=False).pvalue)


def count(verdicts: Sequence[Verdict], corrected: bool = False) -> Tuple[int, int]:
    """Number of worlds where the rival is significantly faster at .05, and where the baseline is.

    With `corrected`, Holm's step-down procedure over all tested worlds keeps the chance of any false one below .05.
    """
    p = np.array([v.p for v in verdicts])
    significant = (holm_adjusted(p) if corrected else p) < LEVEL
    faster, slower = (sum(1 for v, s in zip(verdicts, significant) if s and v.sign == sign) for sign in (-1, 1))
    return faster, slower


def holm_adjusted(p: np.ndarray) -> np.ndarray:
    """(n,) p-values adjusted by Holm's procedure: under .05 the procedure rejects at .05. NaN stays and counts not."""
    adjusted = np.full(len(p), np.nan)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]  # NaN comes last
    adjusted[order] = np.maximum.accumulate(np.minimum(1.0, np.arange(len(order), 0, -1) * p[order]))
    return adjusted


class Paired(NamedTuple):
    """Two methods compared over worlds, in each of which their trials have the same seeds.

    Attributes:
        worlds: number of worlds that both have driven.
        difference: mean over worlds of the difference of their mean times [s], a failed trial counting as the limit.
        low: of its 95 % interval, by bootstrap over worlds.
        high: of the same.
        p: of the two-sided test of this mean by exchanging the two methods in worlds at random (all ways where they are
            at most SIGNS); nan with fewer than two worlds.
    """

    worlds: int
    difference: float
    low: float
    high: float
    p: float


def paired(results: Results, method: str, other: str, worlds: List[str]) -> Paired:
    """The paired comparison of two methods; a negative difference means that `method` is faster."""
    cells = [(results.cells[method][w], results.cells[other][w]) for w in results.both(method, worlds, other)]
    differences = np.array([a.counted.mean() - b.counted.mean() for a, b in cells])
    p = np.nan
    if len(differences) > 1:
        tested = stats.permutation_test(
            (differences,), np.mean, permutation_type="samples", n_resamples=SIGNS, vectorized=True, rng=0
        )
        p = float(tested.pvalue)
    return Paired(len(differences), *over_worlds([differences, np.ones(len(differences))], ratio), p)


def rate(flags: Sequence[np.ndarray]) -> Tuple[float, float, float]:
    """The share of True among the trials of all worlds, flags (n,) for each, with its 95 % interval.

    The interval is Wilson's for as many independent trials as have the variance of this share over the worlds (at most
    as many as there are): trials of a world resemble each other.
    """
    sums, counts = np.array([f.sum() for f in flags], float), np.array([len(f) for f in flags], float)
    n, worlds = counts.sum(), len(flags)
    share = float(sums.sum() / n)
    spread = float(np.square(sums - share * counts).sum()) * worlds / max(1, worlds - 1) / n**2
    return (share, *wilson(share, min(n, share * (1.0 - share) / spread) if spread > 0.0 else n))


def wilson(share: float, n: float) -> Tuple[float, float]:
    """Wilson's 95 % interval of a share of n independent trials."""
    z = float(stats.norm.ppf(0.975))
    middle, half = share + z * z / (2.0 * n), z * math.sqrt(share * (1.0 - share) / n + (z / (2.0 * n)) ** 2)
    return (middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n)


def over_worlds(parts: Sequence[np.ndarray], statistic: Callable[..., np.ndarray]) -> Tuple[float, float, float]:
    """A statistic with its 95 % bootstrap interval over worlds (trials of one world are no independent sample).

    parts      arrays (worlds, ...): what is summed for each world
    statistic  takes the sums (resamples, ...), in order, and returns (resamples,)
    """
    n = len(parts[0])
    if not n:
        return np.nan, np.nan, np.nan
    value = float(statistic(*[part.sum(axis=0)[None] for part in parts])[0])
    if n < 2:
        return value, np.nan, np.nan
    picks = np.random.default_rng(0).integers(0, n, size=(RESAMPLES, n))
    values = statistic(*[part[picks].sum(axis=1) for part in parts])
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, (0.025, 0.975)) if len(values) else (np.nan, np.nan)
    return value, float(low), float(high)


def mean_time(results: Results, method: str, worlds: List[str]) -> Tuple[float, float, float]:
    """Mean over the successful trials [s], with its interval."""
    cells = [results.cells[method][w] for w in worlds if w in results.cells[method]]
    return over_worlds(_sums(cells), ratio)


def mean_counted(results: Results, method: str, worlds: List[str]) -> float:
    """Mean over all trials [s], a failed one counting as the limit; nan without any."""
    counted = results.pooled(method, worlds, "counted")
    return float(counted.mean()) if len(counted) else np.nan


def gain(results: Results, method: str, worlds: List[str]) -> Tuple[float, float, float]:
    """Share of the baseline's mean over all trials (mean_counted) that `method` saves, with its interval."""
    worlds, parts = results.both(method, worlds), []
    for name in (method, results.baseline):
        counted = [results.cells[name][w].counted for w in worlds]
        parts += [np.array([c.sum() for c in counted]), np.array([float(len(c)) for c in counted])]
    return over_worlds(parts, lambda a, n, b, m: 1.0 - ratio(a, n) / ratio(b, m))


def _sums(cells: Sequence[Cell]) -> List[np.ndarray]:
    """Of each cell the sum of the successful trials' times, and how many they are."""
    return [np.array([c.times.sum() for c in cells]), np.array([float(len(c.times)) for c in cells])]


def ratio(total: np.ndarray, n: np.ndarray) -> np.ndarray:
    """The quotient total / n, nan where there is nothing to divide by."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return total / n
