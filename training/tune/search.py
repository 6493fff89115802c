"""The search for one parameter set: races between sets on common trials, CMA-ES by their ranks, and what pays of a set.

In each generation new sets race through the same newly drawn worlds with the same seeds, and CMA-ES is given their
ranks. tune_robot.py calls it.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple, TypeVar

import numpy as np

from applr_ros1.common.extras import extra
from applr_ros1.common.files import sha256
from applr_ros1.planner.variant import DRAWN
from applr_ros1.policy.parameter_space import Space
from training.trials.compare import Estimate, clearly_worse, over_worlds
from training.trials.periodic import CHOOSING
from training.trials.score import Cost, Quantity, summary
from training.trials.trial import Result, Trial, seed_of

with extra(__name__):
    import cma

FINALISTS = 5  # generations whose means take part in the last race: a winner of few drives was mostly lucky
BLOCK = 8  # trials between two tests of a race
LEAST = 0.05  # [s] per course that a parameter has to save

Job = Tuple[int, int]  # index of a world, number of the trial there
Drive = Callable[..., List[List[Result]]]  # gives the results of each of some sets (k, n) in jobs, with a keyword seed
Found = TypeVar("Found")


class Saved(NamedTuple):
    """What a parameter of a set saves per course [s]: the mean, and the median, which no single failure moves."""

    mean: Estimate
    median: float


def plan_sets(
    space: Space, worlds: Sequence[Tuple[str, str]], sets: np.ndarray, jobs: Sequence[Job], seed: int, simulator: str
) -> List[List[Trial]]:
    """Return the trials of each set (k, n) in each job, which all drive with the same seed.

    worlds are [(name, specification), ...]. The trials are named for set and simulator; evaluate.py's have other seeds.
    """
    plan = []
    for values in sets:
        theta = tuple(float(value) for value in space.clip(values))
        method = f"{simulator}-{sha256(repr(theta))[:16]}"
        drawn = [(*worlds[world], number) for world, number in jobs]
        seeds = [seed_of(CHOOSING + seed, name, number) for name, _, number in drawn]
        trials = zip(drawn, seeds)
        plan.append([Trial(n, method, k, s, spec, "", DRAWN, theta=theta) for (n, spec, k), s in trials])
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
) -> Iterator[Dict[str, Any]]:
    """The generations of CMA-ES.

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

    Yields:
        JSON values of each generation: the "sigma" of the distribution after it, its "mean", and the "winner".
    """
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
        parts = drawn[:quarter], drawn[quarter:half], drawn[half:]
        blocks = [[(world, 0) for world in part] for part in parts if part]
        ranking, results = race(partial(run, seed=seed + 1000 + generation), sets, blocks, cost, halve=True)
        strategy.tell(candidates, np.argsort(ranking).astype(float).tolist())
        mean = space.to_theta(np.clip(strategy.result.xfavorite, -1.0, 1.0)).tolist()
        winner = line(space, sets[ranking[0]], results[ranking[0]], cost)
        yield {"sigma": float(strategy.sigma), "winner": winner, "mean": {"theta": mean}}


def finalists(space: Space, starts: Sequence[np.ndarray], log: List[Dict[str, Any]]) -> np.ndarray:
    """Sets (k, n) for the last race, each once: theta_0, the given ones, the means of the last generations."""
    found = [space.theta0, *(space.clip(theta) for theta in starts)]
    found += [line["mean"]["theta"] for line in log[-FINALISTS:]]
    return np.array(list(dict.fromkeys(tuple(float(value) for value in theta) for theta in found)))


def last_race(
    space: Space, run: Drive, sets: np.ndarray, blocks: Iterable[Sequence[Job]], cost: Cost, seed: int
) -> List[Dict[str, Any]]:
    """Races sets (k, n) through blocks of jobs: JSON values of each set, the best first."""
    ranking, results = race(partial(run, seed=seed), sets, blocks, cost)
    return [line(space, sets[i], results[i], cost) for i in ranking]


def without_idle(
    space: Space,
    run: Drive,
    theta: np.ndarray,
    blocks: Callable[[], Iterable[Sequence[Job]]],
    cost: Cost,
    seed: int,
    asked: Sequence[Quantity] = (),
) -> Tuple[np.ndarray, Dict[str, Saved]]:
    """A set (n,) with each parameter at the robot's own value by which nothing is lost; those changed least go first.

    Nothing is lost where neither the mean nor the median of the paired costs is larger by LEAST. A failure costs so
    much that the mean of some drives is mostly of failures: most must not be dearer, either.

    Args:
        space: of the set.
        run: drives both sets of a comparison in the same jobs.
        theta: the set.
        blocks: makes the jobs of a comparison, which ends where one of both is clearly worse.
        cost: of a trial.
        seed: of the trials.
        asked: what no parameter may go back by which one of them is clearly better.

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
        values = (cost, *(quantity.loss for quantity in asked))
        both = (np.array([[value(result) for result in of_set] for of_set in results]) for value in values)
        differences = [more - less for more, less in both]
        mean, *gains = map(over_worlds, differences)
        saved = Saved(mean, float(np.median(differences[0])))
        if max(mean.value, saved.median) < LEAST and not any(gain.low > 0.0 for gain in gains):
            theta = without
        else:
            worth[space.names[i]] = saved
    return theta, worth


def race(
    drive: Callable[[np.ndarray, Sequence[Job]], Sequence[Sequence[Found]]],
    sets: np.ndarray,
    blocks: Iterable[Sequence[Job]],
    cost: Callable[[Found], float],
    halve: bool = False,
) -> Tuple[List[int], List[List[Found]]]:
    """Races sets (k, n) through the same trials, block after block.

    After each block those drop out that a paired test finds clearly worse than the leader (the idea of F-race).

    Args:
        drive: gives the results of each of those sets that are still in the race in the trials of a block.
        sets: at least one.
        blocks: trials in the order in which they are added; the next is asked for when the last is driven.
        cost: of a result; small is good.
        halve: whether at most half of the candidates, rounded up, stay after each block (successive halving).

    Returns:
        The sets' indices, the best first: whoever stayed longer comes before whoever dropped out earlier, and those of
        one block are ordered by their mean cost. The results of each, in the order of the trials.
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


def line(space: Space, theta: np.ndarray, results: Sequence[Result], cost: Cost) -> Dict[str, Any]:
    """What a log says of a set (n,): its mean cost as "score", and how its trials went."""
    found = summary(results, 0.0)
    found["score"] = float(np.mean([cost(result) for result in results]))
    names = ("score", "metric", "time_s", "success", "collided", "trials")
    return {**{name: found[name] for name in names}, "theta": theta.tolist(), "parameters": space.as_dict(theta)}


def said(line: Dict[str, Any]) -> str:
    """A line in words."""
    how = f"{line['success']:.0%} arrive, {line['collided']:.0%} touch something, metric {line['metric']:.3f}"
    return f"score {line['score']:.2f} in {line['trials']} drives ({how.replace('%', ' %')})"


def blocks_of(worlds: int, trials: int, seed: int) -> List[List[Job]]:
    """Each of so many worlds so many times, in an order drawn with the seed, in blocks of BLOCK jobs."""
    order = np.random.default_rng(seed).permutation(worlds).tolist()
    jobs = [(world, trial) for trial in range(trials) for world in order]
    return [jobs[i : i + BLOCK] for i in range(0, len(jobs), BLOCK)]
