"""Search for a parameter set: races of parameter sets on common trials, CMA-ES on the ranks, and pruning.

In each generation, new sets race through the same newly drawn worlds with the same seeds, and CMA-ES gets their ranks.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np

from applr_ros1.common.files import sha256
from applr_ros1.policy.parameter_space import Space
from training.evaluate.compare import clearly_worse, over_worlds
from training.evaluate.periodic import CHOOSING
from training.evaluate.score import summary
from training.evaluate.trial import Trial, seed_of

BLOCK = 8  # number of trials per set between two tests of a race
LEAST = 0.05  # smallest saving per course for which a parameter stays changed [s]

Block = List[int]  # indices of the worlds that each set drives once
# Function that evaluates sets (k, n) in the worlds of a block and returns each set's results; may take a keyword seed
Evaluate = Callable[..., Sequence[Sequence[Any]]]
Cost = Callable[[Any], float]


class Raced(NamedTuple):
    """Parameter set theta (n,) after a race: its index among the starting sets, results and costs of its trials."""

    place: int
    theta: np.ndarray
    results: Sequence[Any]
    costs: np.ndarray

    def __str__(self) -> str:
        means = summary(self.results)
        how = f"{100 * means['success']:.0f} % arrive, {100 * means['collided']:.0f} % touch something"
        return f"cost {self.costs.mean():.2f} s in {means['trials']} drives ({how}, metric {means['metric']:.3f})"


def plan_sets(
    space: Space, worlds: Sequence[Tuple[str, str]], sets: np.ndarray, block: Block, seed: int, simulator: str
) -> List[List[Trial]]:
    """Return the trials of each of `sets` (k, n) in the worlds of a block. In a world, all sets have the same seed.

    Trials are named after set and simulator. Their seeds differ from those of evaluate.py.
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
    rounds: Iterable[Evaluate],
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
        space: Parameter space of the sets.
        worlds: Number of worlds.
        rounds: A function per generation that evaluates its sets. The search ends after the last function.
        starts: Sets (n,), at least one. All enter the first generation, whose distribution is around the first set.
        cost: Function that returns the cost of a result.
        seed: Seed of candidates, worlds and trials.
        sigma: Standard deviation of the first generation, with parameters scaled to [-1, 1].
        population: Number of sets in a generation.
        worlds_per_set: Number of worlds of a generation's race. All sets drive a quarter of the worlds, the better half
            of the sets another quarter, and the better half of these the rest.
    """
    import cma  # slow, because it imports scipy.stats and matplotlib

    middle = np.clip(space.to_action(starts[0]), -0.9, 0.9)  # CMA-ES must not begin on the bounds.
    options = {"bounds": [-1, 1], "popsize": population, "seed": seed + 1, "verbose": -9}
    rng, strategy = np.random.default_rng(seed), cma.CMAEvolutionStrategy(middle, sigma, options)
    for generation, run in enumerate(rounds):
        drawn = rng.permutation(worlds)[:worlds_per_set].tolist()
        candidates = strategy.ask()
        sets = np.array([space.to_theta(action) for action in candidates])
        if generation == 0:
            for i, theta in enumerate(starts[: len(candidates)]):
                candidates[i], sets[i] = space.to_action(theta), space.clip(theta)
        quarter, half = -(-len(drawn) // 4), -(-len(drawn) // 2)
        blocks = [part for part in (drawn[:quarter], drawn[quarter:half], drawn[half:]) if part]
        ranking = race(partial(run, seed=seed + 1000 + generation), sets, blocks, cost, halve=True)
        strategy.tell(candidates, np.argsort([one.place for one in ranking]).astype(float).tolist())
        yield ranking[0], space.to_theta(np.clip(strategy.result.xfavorite, -1.0, 1.0))


def prune_parameters(
    space: Space, run: Evaluate, theta: np.ndarray, blocks: Callable[[], Iterable[Block]], cost: Cost
) -> Tuple[np.ndarray, Dict[str, Tuple[float, ...]]]:
    """Revert parameters of a set (n,) to the robot's defaults if nothing is lost, beginning with the least changed.

    Nothing is lost if neither the mean nor the median of the paired costs rises by LEAST. The median is tested as well,
    because a few failures dominate the mean.

    Args:
        space: Parameter space of the set.
        run: Function that drives both sets of a comparison in the same worlds.
        theta: Set to prune.
        blocks: Function that returns the blocks of a comparison, which ends when one set is clearly worse.
        cost: Function that returns the cost of a result.

    Returns:
        The pruned set, and, for each parameter that stays changed, by how much the cost rises without the change [s]:
        mean, ends of its 95 % interval, and median.
    """
    theta = space.clip(theta)
    saved: Dict[str, Tuple[float, ...]] = {}
    changes = np.abs(space.to_action(theta) - space.to_action(space.theta0))
    for i in np.argsort(changes, kind="stable").tolist():
        if theta[i] == space.theta0[i]:
            continue
        without = np.where(np.arange(len(theta)) == i, space.theta0, theta)
        less, more = sorted(race(run, np.array([without, theta]), blocks(), cost), key=lambda one: one.place)
        lost = less.costs - more.costs
        mean, median = over_worlds(lost), float(np.median(lost))
        if max(mean.value, median) < LEAST:
            theta = without
        else:
            saved[space.names[i]] = (*mean, median)
    return theta, saved


def race(run: Evaluate, sets: np.ndarray, blocks: Iterable[Block], cost: Cost, halve: bool = False) -> List[Raced]:
    """Race sets (k, n) through the same trials, block after block.

    After each block, sets that are clearly worse than the leader by a paired test drop out, similar to F-race.

    Args:
        run: Function that drives the sets still in the race in the trials of a block.
        sets: Parameter sets, at least one.
        blocks: Blocks of trials in order. A block is requested once the block before it is driven.
        cost: Function that returns the cost of a result; less is better.
        halve: Whether at most half of the sets, rounded up, stay after each block (successive halving).

    Returns:
        The sets, best first: first those that stayed longest; sets that dropped out together are sorted by cost.
    """
    racing = [Raced(place, theta, [], np.zeros(0)) for place, theta in enumerate(sets)]
    dropped: List[Raced] = []
    for block in blocks:
        leader = racing[0]
        if leader.results:
            staying = [one for one in racing if one is leader or not clearly_worse(one.costs, leader.costs)]
            staying = staying[: -(-len(racing) // 2)] if halve else staying
            dropped = [one for one in racing if all(one is not other for other in staying)] + dropped
            racing = staying
            if len(racing) == 1:
                break
        driven = run(np.array([one.theta for one in racing]), block)
        results = [[*one.results, *more] for one, more in zip(racing, driven)]
        racing = [Raced(*one[:2], all_, np.array([cost(r) for r in all_])) for one, all_ in zip(racing, results)]
        racing.sort(key=lambda one: float(one.costs.mean()))
    return racing + dropped


def blocks_of(worlds: int, seed: int) -> List[Block]:
    """Return the indices of all worlds, shuffled with the seed, in blocks of BLOCK."""
    order = np.random.default_rng(seed).permutation(worlds).tolist()
    return [order[i : i + BLOCK] for i in range(0, len(order), BLOCK)]
