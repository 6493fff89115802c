"""The paper's statistics, which the report alone has: Welch's tests per world, and Holm's correction."""

from __future__ import annotations

import warnings
from typing import Tuple

import numpy as np
import pandas as pd
import scipy

LEVEL = 0.05


def welch(trials: pd.DataFrame, others: pd.DataFrame) -> pd.DataFrame:
    """Two-sided Welch tests of the successful trials' times of two methods, in each world that both have driven.

    Returns:
        A row per world: "sign", -1 if the first is faster, 1 if the other is; "p", nan where it cannot be tested
        because a side has fewer than two successes.
    """
    ours, theirs = (
        {world: t.time_s[t.success].to_numpy() for world, t in one.groupby("world", sort=False)}
        for one in (trials, others)
    )
    both = [(times, theirs[world]) for world, times in ours.items() if world in theirs]
    signs = [np.sign(a.mean() - b.mean()) if len(a) and len(b) else 0.0 for a, b in both]
    return pd.DataFrame({"sign": signs, "p": [welch_p(a, b) for a, b in both]}, dtype=float)


def welch_p(a: np.ndarray, b: np.ndarray) -> float:
    """The p-value of Welch's t-test; nan with fewer than two values on a side; 0 or 1 where neither side varies."""
    if len(a) < 2 or len(b) < 2:
        return float("nan")
    if np.ptp(a) == 0.0 and np.ptp(b) == 0.0:  # a standard deviation need not be 0 then
        return float(a[0] == b[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # scipy's, where a side hardly varies
        return float(scipy.stats.ttest_ind(a, b, equal_var=False).pvalue)


def count(tests: pd.DataFrame, corrected: bool = False) -> Tuple[int, int]:
    """Number of worlds where the first method is significantly faster at .05, and where the other is.

    With `corrected`, Holm's step-down procedure over all tested worlds keeps the chance of any false one below .05.
    """
    p = tests.p.to_numpy()
    significant = (holm_adjusted(p) if corrected else p) < LEVEL
    return int((significant & (tests.sign == -1)).sum()), int((significant & (tests.sign == 1)).sum())


def holm_adjusted(p: np.ndarray) -> np.ndarray:
    """(n,) p-values adjusted by Holm's procedure: under .05 the procedure rejects at .05. NaN stays and counts not."""
    adjusted = np.full(len(p), np.nan)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]  # NaN comes last
    adjusted[order] = np.maximum.accumulate(np.minimum(1.0, np.arange(len(order), 0, -1) * p[order]))
    return adjusted
