"""The search for one parameter set: races between sets on common trials, CMA-ES by their ranks, and what pays of a set.

In each generation new sets race through the same newly drawn worlds with the same seeds, and CMA-ES is given their
ranks. tune_robot.py calls it.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple, TypeVar

import numpy as np

from applr_ros1.common.extras import extra
from applr_ros1.drives.comparison import Estimate, over_worlds
from applr_ros1.planner.variant import OURS
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot
from training.actors.pool import Pool
from training.env.settings import TrialSettings
from training.evaluation.periodic import CHOOSING
from training.evaluation.plan import Trial, TrialResult, seed_of
from training.evaluation.score import Quantity, clearly_worse, summary
from training.evaluation.store import TrialTable
from training.evaluation.trials import content, drive, drive_missing

with extra(__name__):
    import cma

FINALISTS = 5  # generations whose means take part in the last race: a winner of few drives was mostly lucky
BLOCK = 8  # trials between two tests of a race
LEAST = 0.05  # [s] per course that a parameter has to save

Job = Tuple[int, int]  # index of a world, number of the trial there
Cost = Callable[[TrialResult], float]  # what is made small
DriveTrials = Callable[[Sequence[Trial]], Dict[Trial, TrialResult]]  # evaluation.trials.drive_missing
Found = TypeVar("Found")


class Saved(NamedTuple):
    """What a parameter of a set saves per course [s]: the mean, and the median, which no single failure moves."""

    mean: Estimate
    median: float


class SetTrials:
    """Drives sets of a robot's parameters through worlds.

    Args:
        drive: gives the results of trials.
        worlds: [(name, specification), ...].
        space: of the sets.
        planner: kind of planner (applr_ros1/planner/variant.py).
    """

    def __init__(self, drive: DriveTrials, worlds: Sequence[Tuple[str, str]], space: Space, planner: str = OURS):
        self.drive, self.worlds, self.space, self.planner = drive, worlds, space, planner

    @classmethod
    def kept(
        cls,
        pool: Pool,
        robot: Robot,
        worlds: Sequence[Tuple[str, str]],
        table: Path,
        settings: TrialSettings,
        *,
        planner: str = OURS,
        drive: Callable[..., Any] = drive,
    ) -> SetTrials:
        """Those that a robot drives in a pool of workers. Every trial is kept in a table, the path of its file."""
        kept = TrialTable(table, [settings.model_dump(mode="json", exclude={"robot"}), content(robot)])
        return cls(partial(drive_missing, pool, partial(drive, settings), table=kept), worlds, space_of(robot), planner)

    def run(self, sets: np.ndarray, jobs: Sequence[Job], seed: int) -> List[List[TrialResult]]:
        """Each set (k, n) in each job, which all drive with the same seed: a list of results for each set.

        Raises:
            ApplrError: where a trial fails by an error.
        """
        trials = [[self.trial(theta, world, number, seed) for world, number in jobs] for theta in sets]
        results = self.drive([trial for of_job in zip(*trials) for trial in of_job])  # equal sets drive once
        return [[results[trial] for trial in of_set] for of_set in trials]

    def trial(self, values: np.ndarray, world: int, number: int, seed: int) -> Trial:
        """The trial of a set in a job; evaluate.py's trials have other seeds."""
        name, spec = self.worlds[world]
        theta = tuple(float(value) for value in self.space.clip(values))
        seed = seed_of(CHOOSING + seed, name, number)
        return Trial(name, "set", number, seed, spec, "", self.planner, theta=theta)


def search(
    rounds: Iterable[SetTrials],
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
    for generation, trials in enumerate(rounds):
        space = trials.space
        strategy = strategy or cma.CMAEvolutionStrategy(
            np.clip(space.to_action(starts[0]), -0.9, 0.9),  # not from the very edge of the box
            sigma,
            {"bounds": [-1, 1], "popsize": population, "seed": seed + 1, "verbose": -9},
        )
        drawn = rng.permutation(len(trials.worlds))[:worlds_per_set].tolist()
        candidates = strategy.ask()
        sets = np.array([space.to_theta(action) for action in candidates])
        if generation == 0:
            for i, theta in enumerate(starts[: len(candidates)]):
                candidates[i], sets[i] = space.to_action(theta), space.clip(theta)
        quarter, half = -(-len(drawn) // 4), -(-len(drawn) // 2)
        parts = drawn[:quarter], drawn[quarter:half], drawn[half:]
        blocks = [[(world, 0) for world in part] for part in parts if part]
        drive = partial(trials.run, seed=seed + 1000 + generation)
        ranking, results = race(drive, sets, blocks, cost, halve=True)
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
    trials: SetTrials, sets: np.ndarray, blocks: Iterable[Sequence[Job]], cost: Cost, seed: int
) -> List[Dict[str, Any]]:
    """Races sets (k, n) through blocks of jobs: JSON values of each set, the best first."""
    ranking, results = race(partial(trials.run, seed=seed), sets, blocks, cost)
    return [line(trials.space, sets[i], results[i], cost) for i in ranking]


def without_idle(
    trials: SetTrials,
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
        trials: drives both sets of a comparison in the same jobs.
        theta: the set.
        blocks: makes the jobs of a comparison, which ends where one of both is clearly worse.
        cost: of a trial.
        seed: of the trials.
        asked: what no parameter may go back by which one of them is clearly better.

    Returns:
        The set, and for each parameter that stays in it by how much the cost rises without it.
    """
    space, worth = trials.space, {}
    theta = space.clip(theta)
    changes = np.abs(space.to_action(theta) - space.to_action(space.theta0))
    for i in np.argsort(changes, kind="stable").tolist():
        if theta[i] == space.theta0[i]:
            continue
        without = np.where(np.arange(len(theta)) == i, space.theta0, theta)
        _, results = race(partial(trials.run, seed=seed), np.array([without, theta]), blocks(), cost)
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


def line(space: Space, theta: np.ndarray, results: Sequence[TrialResult], cost: Cost) -> Dict[str, Any]:
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
