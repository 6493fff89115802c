"""A race between candidates on common trials: the clearly worse ones drop out early, so that more can be tried.

Every candidate drives the same trials, block after block. After each block those that a paired test finds worse than
the leader drop out (the idea of F-race), and where `halve` asks for it also the worse half (successive halving).
set_search.py races the candidates of a generation and the finalists of a search.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, List, Sequence, TypeVar

import numpy as np

from training.evaluation.score import LEVEL, clearly_worse

Job = TypeVar("Job")


@dataclass(frozen=True)
class Result:
    """How a race ended.

    Attributes:
        scores: of each candidate, in the order of the trials; shorter for those that dropped out earlier. Small is
            good.
        ranking: all candidates, the best first. Whoever stayed longer comes before whoever dropped out earlier; those
            that dropped out together, and those that reached the end, are ordered by their mean score.
    """

    scores: List[np.ndarray]
    ranking: List[int]


def race(
    drive: Callable[[List[int], Sequence[Job]], np.ndarray],
    candidates: int,
    blocks: Sequence[Sequence[Job]],
    halve: bool = False,
    level: float = LEVEL,
) -> Result:
    """Races candidates 0 .. candidates - 1 through blocks of trials.

    Args:
        drive: gives the scores (k, n) of the k candidates that are still in the race in the n trials of a block.
        candidates: how many there are, at least one.
        blocks: trials in the order in which they are added.
        halve: whether at most half of the candidates, rounded up, stay after each block.
        level: of the test; 0 lets the test drop nobody.
    """
    scores: List[np.ndarray] = [np.empty(0)] * candidates
    racing = list(range(candidates))
    dropped: List[int] = []
    for number, block in enumerate(blocks, start=1):
        for i, more in zip(racing, drive(racing, block)):
            scores[i] = np.append(scores[i], more)
        racing.sort(key=lambda i: float(scores[i].mean()))
        if number == len(blocks):
            break
        leader = racing[0]
        staying = [i for i in racing if i == leader or not clearly_worse(scores[i], scores[leader], level)]
        if halve:
            staying = staying[: -(-len(racing) // 2)]
        dropped = [i for i in racing if i not in staying] + dropped
        racing = staying
        if len(racing) == 1:
            break
    return Result(scores, racing + dropped)
