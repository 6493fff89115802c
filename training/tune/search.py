"""Search for a parameter set: races on common trials, CMA-ES on the ranks, and pruning.

In each generation, new sets race through the same newly drawn worlds with the same seeds, and
CMA-ES gets their ranks.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np
from typing_extensions import override

from applr_ros1.common.files import sha256
from applr_ros1.policy.parameter_space import Space
from training.attempts.verdict import clearly_worse, over_worlds
from training.evaluate.periodic import CHOOSING
from training.evaluate.score import in_words, summary
from training.evaluate.trial import Trial, seed_of

BLOCK = 8  # number of trials per set between two tests of a race
LEAST = 0.05  # smallest saving per course for which a parameter stays changed [s]
SEEDS_APART = 1000  # from the seed of a search to those of its generations, which count upwards

Block = List[int]  # indices of the worlds that each set drives once
# Function that evaluates sets (k, n) in the worlds of a block and returns each set's results; may
# take a keyword seed
Evaluate = Callable[..., Sequence[Sequence[Any]]]
Cost = Callable[[Any], float]


class Effect(NamedTuple):
    """Rise of the cost per course if one parameter of a set is reverted to its default [s].

    Attributes:
        mean: Mean rise.
        low: Lower end of its 95 % confidence interval.
        high: Upper end of the interval.
        median: Median rise. A few failures change the mean and its interval strongly, but not the
            median.
    """

    mean: float
    low: float
    high: float
    median: float

    @property
    def is_saving(self) -> bool:
        """True if the changed value saves something: the interval lies above 0."""
        return self.low > 0.0


class Raced(NamedTuple):
    """Parameter set after a race.

    Attributes:
        place: Index among the starting sets.
        theta: Parameters (n,).
        results: Results of its trials.
        costs: Costs (k,) of its trials [s].
    """

    place: int
    theta: np.ndarray
    results: Sequence[Any]
    costs: np.ndarray

    @override
    def __str__(self) -> str:
        return f"cost {self.costs.mean():.2f} s in {in_words(summary(self.results))}"


def plan_sets(
    space: Space,
    worlds: Sequence[Tuple[str, str]],
    sets: np.ndarray,
    block: Block,
    seed: int,
    simulator: str,
) -> List[List[Trial]]:
    """Return the trials of each of `sets` (k, n) in the worlds of a block.

    In a world, all sets have the same seed. Trials are named after set and simulator. Their seeds
    differ from those of ./applr evaluate.
    """
    plan = []
    for values in sets:
        theta = tuple(map(float, space.clip(values)))
        method = f"{simulator}-{sha256(repr(theta))[:16]}"
        trials = []
        for world_index in block:
            world_name, specification = worlds[world_index]
            drawn_seed = seed_of(CHOOSING + seed, world_name, trial=0)
            trials.append(
                Trial(
                    world=world_name,
                    method=method,
                    trial=0,
                    seed=drawn_seed,
                    world_spec=specification,
                    method_spec="",  # The set is driven instead of a method.
                    theta=theta,
                )
            )
        plan.append(trials)
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
        rounds: A function per generation that evaluates its sets. The search ends after the last
            function.
        starts: Sets (n,), at least one. All enter the first generation, whose distribution is
            around the first set.
        cost: Function that returns the cost of a result.
        seed: Seed of candidates, worlds and trials.
        sigma: Standard deviation of the first generation, with parameters scaled to [-1, 1].
        population: Number of sets in a generation.
        worlds_per_set: Number of worlds of a generation's race. All sets drive a quarter of the
            worlds, the better half of the sets another quarter, and the better half of these the
            rest.
    """
    import cma  # slow, because it imports scipy.stats and matplotlib

    # CMA-ES must not begin on the bounds.
    first_action = np.clip(space.to_action(starts[0]), -0.9, 0.9)
    options = {"bounds": [-1, 1], "popsize": population, "seed": seed + 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(first_action, sigma, options)
    rng = np.random.default_rng(seed)
    for generation, run in enumerate(rounds):
        drawn_worlds = rng.permutation(worlds)[:worlds_per_set].tolist()
        candidates = strategy.ask()
        sets = np.array(list(map(space.to_theta, candidates)))
        if generation == 0:
            for start_index, theta in enumerate(starts[: len(candidates)]):
                candidates[start_index] = space.to_action(theta)
                sets[start_index] = space.clip(theta)

        quarter_count = math.ceil(len(drawn_worlds) / 4)
        half_count = math.ceil(len(drawn_worlds) / 2)
        rounds_of_race = [
            drawn_worlds[:quarter_count],
            drawn_worlds[quarter_count:half_count],
            drawn_worlds[half_count:],
        ]
        # Few worlds leave a quarter empty.
        blocks = filter(None, rounds_of_race)
        drive = partial(run, seed=seed + SEEDS_APART + generation)
        ranking = race(drive, sets, blocks, cost, halve=True)

        # Only ranks matter to CMA-ES: a set that dropped out early has driven fewer courses.
        places = [raced.place for raced in ranking]
        ranks = np.argsort(places).astype(float)  # The inverse of an order gives the ranks.
        strategy.tell(candidates, ranks.tolist())
        mean_action = np.clip(strategy.result.xfavorite, -1.0, 1.0)
        yield ranking[0], space.to_theta(mean_action)


def prune_parameters(
    space: Space,
    run: Evaluate,
    theta: np.ndarray,
    blocks: Callable[[], Iterable[Block]],
    cost: Cost,
) -> Tuple[np.ndarray, Dict[str, Effect]]:
    """Revert parameters of a set (n,) to the robot's defaults if nothing is lost.

    The least changed parameter comes first. Nothing is lost if neither the mean nor the median of
    the paired costs rises by LEAST. The median is tested as well, because a few failures dominate
    the mean.

    Args:
        space: Parameter space of the set.
        run: Function that drives both sets of a comparison in the same worlds.
        theta: Set to prune.
        blocks: Function that returns the blocks of a comparison, which ends when one set is clearly
            worse.
        cost: Function that returns the cost of a result.

    Returns:
        The pruned set, and the effect of each parameter that stays changed.
    """
    theta = space.clip(theta)
    effects: Dict[str, Effect] = {}
    distances = np.abs(space.to_action(theta) - space.to_action(space.theta0))
    for index in np.argsort(distances, kind="stable").tolist():
        if theta[index] == space.theta0[index]:
            continue
        reverted = theta.copy()
        reverted[index] = space.theta0[index]
        ranking = race(run, np.array([reverted, theta]), blocks(), cost)
        reverted_set, changed_set = sorted(ranking, key=lambda raced: raced.place)
        rises = reverted_set.costs - changed_set.costs
        mean_rise = over_worlds(rises)
        median_rise = float(np.median(rises))
        if max(mean_rise.value, median_rise) < LEAST:
            theta = reverted
        else:
            effects[space.names[index]] = Effect(*mean_rise, median_rise)
    return theta, effects


def race(
    run: Evaluate, sets: np.ndarray, blocks: Iterable[Block], cost: Cost, halve: bool = False
) -> List[Raced]:
    """Race sets (k, n) through the same trials, block after block.

    After each block, sets that are clearly worse than the leader by a paired test drop out, similar
    to F-race.

    Args:
        run: Function that drives the sets still in the race in the trials of a block.
        sets: Parameter sets, at least one.
        blocks: Blocks of trials in order. A block is requested once the block before it is driven.
        cost: Function that returns the cost of a result; less is better.
        halve: Whether at most half of the sets, rounded up, stay after each block (successive
            halving).

    Returns:
        The sets, best first: first those that stayed longest; sets that dropped out together are
            sorted by cost.
    """
    racing = []
    for place, theta in enumerate(sets):
        racing.append(Raced(place, theta, results=[], costs=np.zeros(0)))
    dropped: List[Raced] = []
    for block in blocks:
        # Nothing can be compared before the first block.
        if racing[0].results:
            racing, leaving = _divided(racing, halve)
            dropped = leaving + dropped
            if len(racing) == 1:
                break

        driven = run(np.array([raced.theta for raced in racing]), block)
        for position, new_results in enumerate(driven):
            raced = racing[position]
            results = [*raced.results, *new_results]
            costs = np.array(list(map(cost, results)))
            racing[position] = raced._replace(results=results, costs=costs)
        racing.sort(key=lambda raced: float(raced.costs.mean()))
    return racing + dropped


def _divided(racing: Sequence[Raced], halve: bool) -> Tuple[List[Raced], List[Raced]]:
    """Return the sets that stay in a race and those that drop out, each best first.

    The leader always stays.
    """
    leader = racing[0]
    most_staying = len(racing)
    if halve:
        most_staying = math.ceil(len(racing) / 2)
    staying = [leader]
    leaving = []
    for raced in racing[1:]:
        if len(staying) == most_staying or clearly_worse(raced.costs, leader.costs):
            leaving.append(raced)
        else:
            staying.append(raced)
    return staying, leaving


def blocks_of(worlds: int, seed: int) -> List[Block]:
    """Return the indices of all worlds, shuffled with the seed, in blocks of BLOCK."""
    world_order = np.random.default_rng(seed).permutation(worlds).tolist()
    blocks = []
    for block_begin in range(0, len(world_order), BLOCK):
        blocks.append(world_order[block_begin : block_begin + BLOCK])
    return blocks
