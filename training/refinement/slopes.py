"""From the scores of pairs of drives to the shift of a policy that is expected to be best.

The expected score of a policy with coefficients x is taken as f(x) = f(0) + g·x + h |x|² / 2. Of a pair driven at c + e
and c - e, half the difference of the scores is then e·g + h e·c and noise, whatever the world adds to both. So all
pairs of a search, wherever its centre was, are fitted together: Bayesian linear regression for g and h, in which the
data also set how large the slopes are believed to be (MacKay 1992): those of the constants, and those of each component
of the last hidden layer, for themselves. Slopes that the noise hides stay small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

CURVATURE = 2.0, 1.0  # h as believed before any drive: mean and standard deviation [s per unit²]
LEAST_CURVATURE = 0.5  # [s per unit²], which bounds how far the optimum can lie
LEAST_SPREAD = 1e-3  # [s per unit]
ROUNDS = 300


class Fit(NamedTuple):
    """What the pairs say.

    Attributes:
        slopes: (n,) g [s per unit].
        errors: (n,) their standard deviations [s per unit].
        curvature: h [s per unit²].
        spread: (groups,) the standard deviations that the slopes of each group are believed to have [s per unit].
        noise: the standard deviation of half a difference [s].
    """

    slopes: np.ndarray
    errors: np.ndarray
    curvature: float
    spread: np.ndarray
    noise: float

    @property
    def best(self) -> np.ndarray:
        """The coefficients (n,) with the lowest expected score."""
        return -self.slopes / max(self.curvature, LEAST_CURVATURE)

    def gain(self, coefficients: np.ndarray) -> float:
        """What the coefficients (n,) are expected to take from the score [s], by these slopes and this curvature."""
        return -float(self.slopes @ coefficients + 0.5 * self.curvature * coefficients @ coefficients)


def fit(shifts: np.ndarray, centres: np.ndarray, halves: np.ndarray, groups: np.ndarray) -> Fit:
    """Fits all pairs.

    Args:
        shifts: (m, n) e of each pair.
        centres: (m, n) c of each pair.
        halves: (m,) half the differences of the scores, f(c + e) - f(c - e) [s].
        groups: (n,) the number of the group that a coefficient's slope belongs to, from 0.
    """
    n = shifts.shape[1]
    columns = np.column_stack([shifts, (shifts * centres).sum(axis=1)])
    squares, products = columns.T @ columns, columns.T @ halves
    before = np.append(np.zeros(n), CURVATURE[0])
    noise, spread = float(halves.std()) or 1e-6, np.ones(n)
    members = np.eye(groups.max() + 1)[groups] / np.bincount(groups)  # (n, groups): takes the mean in each
    for _ in range(ROUNDS):
        precision = np.append(spread**-2, CURVATURE[1] ** -2)
        covariance = np.linalg.inv(squares / noise**2 + np.diag(precision))
        mean = covariance @ (products / noise**2 + precision * before)
        expected = mean[:n] ** 2 + np.diag(covariance)[:n]
        spread = np.maximum(np.sqrt(expected @ members), LEAST_SPREAD)[groups]
        residue = np.sum((halves - columns @ mean) ** 2) + np.sum(covariance * squares)
        noise = max(1e-6, float(np.sqrt(residue / len(halves))))
    _, first = np.unique(groups, return_index=True)
    return Fit(mean[:n], np.sqrt(np.diag(covariance)[:n]), float(mean[n]), spread[first], noise)
