"""Tests of the best-first search: its result is that of scoring every sample."""

import numpy as np
import pytest

from applr_ros1.planner.search.best_first import HUGE, add, first_step, next_step
from tests.support.seeds import seeds

ILLEGAL = -1.0


def search(lower_bounds, closer_bounds, costs):
    """Return the last step of a search among all samples, and the numbers whose cost it asked."""
    count = len(costs)
    bounds = np.zeros(count)
    heap = np.zeros(count, np.int64)
    is_probed = np.ones(count, np.uint8)
    for number in range(count):
        add.py_func(bounds, heap, is_probed, number, number, lower_bounds[number])
    scored_samples = []
    step = first_step(bounds, heap, is_probed, count)
    while step.number >= 0:
        if step.is_exact:
            scored_samples.append(step.number)
            answer = costs[step.number]
        else:
            answer = closer_bounds[step.number]
        step = next_step.py_func(bounds, heap, is_probed, step, float(answer))
    return step, scored_samples


@seeds(40)
def test_the_first_sample_of_lowest_cost_is_found(seed):
    rng = np.random.default_rng(seed)
    costs = rng.integers(0, 6, 30).astype(float)  # many equal costs
    closer_bounds = costs - rng.integers(0, 3, 30)
    lower_bounds = closer_bounds - rng.integers(0, 3, 30)
    costs[rng.random(30) < 0.3] = ILLEGAL

    step, scored_samples = search(lower_bounds, np.maximum(closer_bounds, 0.0), costs)

    legal_costs = np.where(costs >= 0, costs, np.inf)
    assert step.best_number == legal_costs.argmin()
    assert step.best_cost == legal_costs.min()
    assert len(set(scored_samples)) == len(scored_samples)


def test_samples_that_cannot_win_are_not_scored():
    lower_bounds = [4.0, 0.0, 1.0, 2.0, 3.0, 3.0]
    closer_bounds = [4.0, 5.0, ILLEGAL, 2.0, 3.0, 3.0]
    costs = [9.0, 5.0, 1.0, 3.0, 4.0, 3.0]

    step, scored_samples = search(lower_bounds, closer_bounds, costs)

    # Sample 1 is put back by its closer bound, and sample 2 is illegal. Samples 4 and 5 could at
    # best equal sample 3, which comes first.
    assert scored_samples == [3]
    assert (step.best_number, step.best_cost) == (3, 3.0)


@pytest.mark.parametrize("costs", [[], [ILLEGAL, ILLEGAL]])
def test_without_a_legal_sample_there_is_no_best_one(costs):
    zeros = np.zeros(len(costs))
    step, _ = search(zeros, zeros, costs)
    assert step.best_number == -1
    assert step.best_cost == HUGE
