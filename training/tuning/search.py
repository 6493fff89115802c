"""The search for one parameter set: races between sets on common trials, CMA-ES by their ranks, and what pays of a set.

In each generation new sets race through the same newly drawn worlds with the same seeds, and CMA-ES is given their
ranks. tune_robot.py calls it.
"""

from __future__ import annotations

from functools import partial
from typing import Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple, TypeVar

import numpy as np

from applr_ros1.common.files import sha256
from applr_ros1.policy.parameter_space import Space
from training.evaluation.compare import Estimate, clearly_worse, over_worlds
from training.evaluation.periodic import CHOOSING
from training.evaluation.score import Cost, summary
from training.evaluation.trial import Result, Trial, seed_of

FINALISTS = 5  # generations whose means take part in the last race: a winner of few drives was mostly lucky
BLOCK = 8  # trials between two tests of a race
LEAST = 0.05  # [s] per course that a parameter has to save

Block = List[int]  # indices of worlds in which sets drive once each
Drive = Callable[
    ..., List[List[Result]]
]  # gives the results of each of some sets (k, n) in a block, with a keyword seed
Found = TypeVar("Found")


class Raced(NamedTuple):
    """A set (n,) after a race: its mean cost, and how its trials went."""

    theta: np.ndarray
    cost: float
    results: Sequence[Result]

    def __str__(self) -> str:
        found = summary(self.results)
        how = f"{found['success']:.0%} arrive, {found['collided']:.0%} touch something, metric {found['metric']:.3f}"
        return f"score {self.cost:.2f} in {found['trials']} drives ({how.replace('%', ' %')})"


class Saved(NamedTuple):
    """The gain of a parameter per course [s]: its mean, and its median, which no single failure moves."""

    mean: Estimate
    median: float


def plan_sets(
    space: Space, worlds: Sequence[Tuple[str, str]], sets: np.ndarray, block: Block, seed: int, simulator: str
) -> List[List[Trial]]:
    """Return the trials of each set (k, n) in some worlds, [(name, specification), ...], in which all have one seed.

    Trials are named for set and simulator; evaluate.py's have other seeds.
    """
    courses = [(*worlds[i], seed_of(CHOOSING + seed, worlds[i][0], 0)) for i in block]
    plan = []
    for theta in (tuple(map(float, space.clip(values))) for values in sets):
        method = f"{simulator}-{sha256(repr(theta))[:16]}"
        plan.append([Trial(name, method, 0, drawn, spec, "", theta=theta) for name, spec, drawn in courses])
    return plan


def search(
    space: Space,
    worlds: int,
    rounds: Iterable[Drive],
    starts: Sequence[np.ndarray],
    cost: Cost,
    *,
    seed: int,
    sigma: float,
    population: int,
    worlds_per_set: int,
) -> Iterator[Tuple[Raced, np.ndarray]]:
    """Yield the winner of each generation of CMA-ES, and the mean of the distribution after it.

    Args:
        space: of the sets.
        worlds: how many there are.
        rounds: what drives the sets of each generation; no generation begins after the last.
        starts: sets (n,), at least one. The distribution begins around the first; all take part in the first
            generation.
        cost: of a trial.
        seed: of candidates, worlds and trials.
        sigma: standard deviation of the first generation, with parameters scaled to [-1, 1].
        population: sets in a generation.
        worlds_per_set: worlds in which a generation races: all sets drive a quarter of them, the better half another
            quarter, and the better half of those the rest.
    """
    import cma  # and with it scipy.stats and matplotlib

    rng, strategy = np.random.default_rng(seed), None
    for generation, run in enumerate(rounds):
        strategy = strategy or cma.CMAEvolutionStrategy(
            np.clip(space.to_action(starts[0]), -0.9, 0.9),  # not from the very edge of the box
            sigma,
            {"bounds": [-1, 1], "popsize": population, "seed": seed + 1, "verbose": -9},
        )
        drawn = rng.permutation(worlds)[:worlds_per_set].tolist()
        candidates = strategy.ask()
        sets = np.array([space.to_theta(action) for action in candidates])
        if generation == 0:
            for i, theta in enumerate(starts[: len(candidates)]):
                candidates[i], sets[i] = space.to_action(theta), space.clip(theta)
        quarter, half = -(-len(drawn) // 4), -(-len(drawn) // 2)
        blocks = [part for part in (drawn[:quarter], drawn[quarter:half], drawn[half:]) if part]
        ranking, results = race(partial(run, seed=seed + 1000 + generation), sets, blocks, cost, halve=True)
        strategy.tell(candidates, np.argsort(ranking).astype(float).tolist())
        yield raced(sets, ranking[:1], results, cost)[0], space.to_theta(np.clip(strategy.result.xfavorite, -1.0, 1.0))


def finalists(space: Space, starts: Sequence[np.ndarray], means: Sequence[np.ndarray]) -> np.ndarray:
    """Return the sets (k, n) of the last race, each once: theta_0, the given ones, means of the last generations."""
    found = [space.theta0, *(space.clip(theta) for theta in starts), *means[-FINALISTS:]]
    return np.array(list(dict.fromkeys(tuple(map(float, theta)) for theta in found)))


def last_race(run: Drive, sets: np.ndarray, blocks: Iterable[Block], cost: Cost, seed: int) -> List[Raced]:
    """Race sets (k, n) through blocks of worlds; return them, the best first."""
    return raced(sets, *race(partial(run, seed=seed), sets, blocks, cost), cost)


def raced(sets: np.ndarray, ranking: Sequence[int], results: Sequence[Sequence[Result]], cost: Cost) -> List[Raced]:
    """Return the sets of a ranking with what they cost."""
    return [Raced(sets[i], float(np.mean([cost(result) for result in results[i]])), results[i]) for i in ranking]


def without_idle(
    space: Space,
    run: Drive,
    theta: np.ndarray,
    blocks: Callable[[], Iterable[Block]],
    cost: Cost,
    seed: int,
) -> Tuple[np.ndarray, Dict[str, Saved]]:
    """Put parameters of a set (n,) back at the robot's own values where nothing is lost, those changed least first.

    Nothing is lost where neither the mean nor the median of the paired costs is larger by LEAST. A failure costs so
    much that the mean of some drives is mostly of failures: most must not be dearer, either.

    Args:
        space: of the set.
        run: drives both sets of a comparison in the same worlds.
        theta: the set.
        blocks: makes the blocks of a comparison, which ends where one of both is clearly worse.
        cost: of a trial.
        seed: of the trials.

    Returns:
        The set, and for each parameter that stays in it by how much the cost rises without it.
    """
    theta, worth = space.clip(theta), {}
    changes = np.abs(space.to_action(theta) - space.to_action(space.theta0))
    for i in np.argsort(changes, kind="stable").tolist():
        if theta[i] == space.theta0[i]:
            continue
        without = np.where(np.arange(len(theta)) == i, space.theta0, theta)
        _, results = race(partial(run, seed=seed), np.array([without, theta]), blocks(), cost)
        without_it, with_it = np.array([[cost(result) for result in of_set] for of_set in results])
        saved = Saved(over_worlds(without_it - with_it), float(np.median(without_it - with_it)))
        if max(saved.mean.value, saved.median) < LEAST:
            theta = without
        else:
            worth[space.names[i]] = saved
    return theta, worth


def race(
    drive: Callable[[np.ndarray, Block], Sequence[Sequence[Found]]],
    sets: np.ndarray,
    blocks: Iterable[Block],
    cost: Callable[[Found], float],
    halve: bool = False,
) -> Tuple[List[int], List[List[Found]]]:
    """Race sets (k, n) through the same trials, block after block.

    After each block those drop out that a paired test finds clearly worse than the leader (the idea of F-race).

    Args:
        drive: gives the results of each of those sets that are still in the race in the trials of a block.
        sets: at least one.
        blocks: trials in the order in which they are added; the next is asked for when the last is driven.
        cost: of a result; small is good.
        halve: whether at most half of the candidates, rounded up, stay after each block (successive halving).

    Returns:
        The sets' indices, the best first: those that stayed longer come before those that dropped out earlier, and
        those of one block are ordered by their mean cost. The results of each, in the order of the trials.
    """
    results: List[List[Found]] = [[] for _ in sets]
    racing: List[int] = list(range(len(sets)))
    dropped: List[int] = []
    costs: Dict[int, np.ndarray] = {}
    for block in blocks:
        if costs:
            leader = racing[0]
            staying = [i for i in racing if i == leader or not clearly_worse(costs[i], costs[leader])]
            if halve:
                staying = staying[: -(-len(racing) // 2)]
            dropped = [i for i in racing if i not in staying] + dropped
            racing = staying
            if len(racing) == 1:
                break
        for i, more in zip(racing, drive(sets[racing], block)):
            results[i] += more
        costs = {i: np.array([cost(result) for result in results[i]]) for i in racing}
        racing.sort(key=lambda i: float(costs[i].mean()))
    return racing + dropped, results


def blocks_of(worlds: int, seed: int) -> List[Block]:
    """Return all of so many worlds once, in an order drawn with the seed, in blocks of BLOCK."""
    order = np.random.default_rng(seed).permutation(worlds).tolist()
    return [order[i : i + BLOCK] for i in range(0, len(order), BLOCK)]
