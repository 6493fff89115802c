"""Search for the sample of lowest cost without rolling out the samples that cannot win.

Called by dwa/search.py and trajectory/forward.py. Samples are numbers that wait in a heap, ordered
by a lower bound of their cost. The sample with the lowest bound is looked at next, first by a
closer bound and then by its exact cost. The search ends when no bound beats the best cost. A bound
never exceeds the exact cost, so the result is that of scoring every sample.
"""

from typing import NamedTuple

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel

HUGE = float(np.finfo(np.float64).max)


class SearchStep(NamedTuple):
    """Question of a search to its caller, with what the search has found so far."""

    number: int  # number of the sample that the question is about, -1 if the search has ended
    is_exact: bool  # whether the sample's exact cost is asked for, or else a closer bound of it
    waiting_count: int  # number of samples in the heap
    best_cost: float  # cost of the best sample, HUGE if no sample is legal
    best_number: int  # number of the best sample, -1 if no sample is legal


@kernel(inline="always")
def add(bounds: Data, heap: Data, is_probed: Data, count: int, number: int, bound: float) -> int:
    """Add a sample to the `count` samples in an unordered heap, and return the new count."""
    bounds[number] = bound
    is_probed[number] = 0
    heap[count] = number
    return count + 1


@kernel
def first_step(bounds: Data, heap: Data, is_probed: Data, count: int) -> SearchStep:
    """Return the first question of a search among the `count` samples in an unordered heap.

    See next_step for the arrays.
    """
    for i in range(count // 2 - 1, -1, -1):
        _sift_down(heap, bounds, count, i)
    return _question(bounds, heap, is_probed, count, HUGE, -1)


@kernel(inline="always")
def next_step(
    bounds: Data, heap: Data, is_probed: Data, step: SearchStep, answer: float
) -> SearchStep:
    """Return the question that follows the answer to a question.

    The function becomes part of the kernel that calls it. The caller answers between two calls, and
    the arrays are arguments of their own, because numba counts references wherever it opens a tuple
    with arrays. A search that calls kernels for its answers takes 7 to 15 % longer.

    Args:
        bounds: lower bounds of the samples' costs, by number.
        heap: numbers of the waiting samples, lowest bound first.
        is_probed: whether the closer bound of a sample has been asked for, by number.
        step: the question.
        answer: closer bound or exact cost of the sample, negative if the sample is illegal. An
            exact cost above the best one may be too low if it stays above.
    """
    number = step.number
    count = step.waiting_count
    best_cost = step.best_cost
    best_number = step.best_number
    if not step.is_exact and answer >= 0:
        if answer <= bounds[number]:
            # The sample stays the first one.
            return SearchStep(number, True, count, best_cost, best_number)
        bounds[number] = answer
        _sift_down(heap, bounds, count, 0)
        return _question(bounds, heap, is_probed, count, best_cost, best_number)
    if step.is_exact and answer >= 0 and _is_before(answer, number, best_cost, best_number):
        best_cost = answer
        best_number = number
    count -= 1
    heap[0] = heap[count]
    _sift_down(heap, bounds, count, 0)
    return _question(bounds, heap, is_probed, count, best_cost, best_number)


@kernel(inline="always")
def _question(
    bounds: Data, heap: Data, is_probed: Data, count: int, best_cost: float, best_number: int
) -> SearchStep:
    """Return the question about the first of `count` samples in the heap."""
    # If the first sample does not beat the best one, no other sample does.
    if count == 0 or _is_before(best_cost, best_number, bounds[heap[0]], heap[0]):
        return SearchStep(-1, True, count, best_cost, best_number)
    number = heap[0]
    is_exact = is_probed[number] != 0
    is_probed[number] = 1
    return SearchStep(number, is_exact, count, best_cost, best_number)


@kernel
def _sift_down(heap: Data, bounds: Data, count: int, i: int) -> None:
    """Restore the heap of sample numbers after the bound of heap[i] grew.

    The sample with the lowest bound is on top, among equal bounds that with the lowest number.
    """
    sample = heap[i]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        sibling = child + 1
        if sibling < count and _is_before(
            bounds[heap[sibling]], heap[sibling], bounds[heap[child]], heap[child]
        ):
            child = sibling
        if not _is_before(bounds[heap[child]], heap[child], bounds[sample], sample):
            break
        heap[i] = heap[child]
        i = child
    heap[i] = sample


@kernel
def _is_before(cost: float, number: int, other_cost: float, other_number: int) -> bool:
    """Return whether a sample is better than another one: the first one among equal costs."""
    return cost < other_cost or (cost == other_cost and number < other_number)
