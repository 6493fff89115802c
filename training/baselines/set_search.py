"""The best single set of parameters, by CMA-ES and races: the strong rival of a policy. static_search.py calls it.

In each generation the candidates race through the same freshly drawn worlds with the same seeds; CMA-ES is given their
ranks. At the end the given sets, theta_0, the means of the last generations and their winners race for the first place.
"""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, List, Literal, Sequence, Tuple

import cma
import numpy as np

from applr_ros1.planner.variant import OURS
from applr_ros1.policy.parameter_space import Space
from training.actors.tasks import Trial, TrialResult
from training.baselines.race import Result, race
from training.common.command_line import ContactSeconds, Seed
from training.common.options import Options, option
from training.evaluation.periodic import CHOOSING
from training.evaluation.remembered import RememberedTrials
from training.evaluation.score import CONTACT_SECONDS, barn_metric, summary, trial_seconds
from training.evaluation.trials import seed_of

FINALISTS = 5  # generations whose means and winners take part in the last race
FINAL_BLOCK = 8  # trials between two tests of the last race

Job = Tuple[int, int]  # index of a world, number of the trial there


class SetTrials:
    """Drives sets of a robot's parameters through worlds.

    Args:
        trials: drives the trials.
        worlds: [(name, specification), ...].
        space: of the sets.
        planner: kind of planner (applr_ros1/planner/variant.py).
    """

    def __init__(self, trials: RememberedTrials, worlds: Sequence[Tuple[str, str]], space: Space, planner: str = OURS):
        self.trials, self.worlds, self.space, self.planner = trials, worlds, space, planner
        self.driven = 0  # trials, those of the table included

    def run(self, sets: np.ndarray, jobs: Sequence[Job], seed: int) -> List[List[TrialResult]]:
        """Each set (k, n) in each job, which all drive with the same seed: a list of results for each set.

        Raises:
            ApplrError: where a trial fails by an error.
        """
        trials = [[self._trial(theta, world, number, seed) for world, number in jobs] for theta in sets]
        results = self.trials.run([trial for of_job in zip(*trials) for trial in of_job])  # equal sets drive once
        self.driven += len(results)
        return [[results[trial] for trial in own] for own in trials]

    def _trial(self, values: np.ndarray, world: int, number: int, seed: int) -> Trial:
        name, spec = self.worlds[world]
        theta = tuple(float(value) for value in self.space.clip(values))
        seed = seed_of(CHOOSING + seed, name, number)
        return Trial(name, "set", number, seed, spec, "", self.planner, theta=theta)


class SearchOptions(Options):
    """What to search, and how."""

    # fmt: off
    generations: int = option(40, "Number of generations of CMA-ES.", ge=1, le=10**6)
    population: int = option(16, "Number of parameter sets in a generation.", ge=4, le=10**6)
    worlds_per_set: int = option(24,
        "Number of worlds that a generation races in: all sets drive a quarter of them, the better half another "
        "quarter, and the better half of those the rest.", ge=1, le=10**6)
    sigma: float = option(0.5,
        "Initial standard deviation of the search, with parameters scaled to [-1, 1].", ge=1e-3, le=2)
    seed: Seed
    objective: Literal["score", "metric"] = option("score",
        "What is searched for: the smallest score, the time in seconds of a trial with 100 s for a failure; or the "
        "largest BARN metric, success x OT / clip(time, 2 OT, 8 OT), where OT is the reference path over 2 m/s.")
    contact_seconds: ContactSeconds = CONTACT_SECONDS
    final_trials: int = option(2, "Number of trials in each world of the last race.", ge=1, le=1000)
    # fmt: on

    def price(self, result: TrialResult) -> float:
        """What is made small: a trial's score [s], or its negated metric."""
        if self.objective == "metric":
            return -float(barn_metric(result.success, result.collided, result.time_s, result.route_m))
        return trial_seconds(result.success, result.time_s, result.collided, self.contact_seconds)


def explore(
    trials: SetTrials, starts: Sequence[np.ndarray], options: SearchOptions, tell: Callable[[str], None] = print
) -> List[Dict[str, Any]]:
    """The generations of CMA-ES.

    Args:
        trials: drives the candidates.
        starts: sets (n,), at least one. The distribution begins around the first; all take part in the first
            generation.
        options: of the search.
        tell: takes a line of progress for each generation.

    Returns:
        A dict of JSON values for each generation, with its "winner" and the "mean" of the distribution after it.
    """
    rng, space = np.random.default_rng(options.seed), trials.space
    strategy = cma.CMAEvolutionStrategy(
        np.clip(space.to_action(starts[0]), -0.9, 0.9),  # not from the very edge of the box
        options.sigma,
        {"bounds": [-1, 1], "popsize": options.population, "seed": options.seed + 1, "verbose": -9},
    )
    began, log = time.monotonic(), []
    for generation in range(options.generations):
        drawn = rng.permutation(len(trials.worlds))[: options.worlds_per_set].tolist()
        candidates = strategy.ask()
        sets = np.array([space.to_theta(action) for action in candidates])
        if generation == 0:
            for i, theta in enumerate(starts[: len(candidates)]):
                candidates[i], sets[i] = space.to_action(theta), space.clip(theta)
        results, raced = drive_race(
            trials,
            sets,
            halving_blocks([(world, 0) for world in drawn]),
            options.seed + 1000 + generation,
            options.price,
            halve=True,
        )
        ranks = np.empty(len(candidates))
        ranks[raced.ranking] = np.arange(len(candidates))
        strategy.tell(candidates, ranks.tolist())
        winner = _line(space, sets[raced.ranking[0]], results[raced.ranking[0]], options.contact_seconds)
        seconds = round(time.monotonic() - began, 1)
        log.append(
            {
                "generation": generation,
                "worlds": drawn,
                "sigma": float(strategy.sigma),
                "trials_of_each": [len(scores) for scores in raced.scores],
                "scores": [round(float(scores.mean()), 3) for scores in raced.scores],
                "winner": winner,
                "mean": {"theta": space.to_theta(np.clip(strategy.result.xfavorite, -1.0, 1.0)).tolist()},
                "trials": trials.driven,
                "seconds": seconds,
            }
        )
        tell(
            f"generation {generation + 1} of {options.generations}: winner {_summary(winner)}, sigma "
            f"{strategy.sigma:.3f}, {trials.driven} trials in all, {seconds:.0f} s"
        )
    return log


def finalists(space: Space, starts: Sequence[np.ndarray], log: List[Dict[str, Any]]) -> List[List[float]]:
    """Sets for the last race, each once: theta_0, the given ones, means and winners of the last generations."""
    found = [space.theta0, *(space.clip(theta) for theta in starts)]
    found += [line[which]["theta"] for line in log[-FINALISTS:] for which in ("mean", "winner")]
    return [list(theta) for theta in dict.fromkeys(tuple(float(value) for value in theta) for theta in found)]


def choose(
    trials: SetTrials, sets: Sequence[Sequence[float]], options: SearchOptions, tell: Callable[[str], None] = print
) -> List[Dict[str, Any]]:
    """The last race.

    Args:
        trials: drives the sets, in each of its worlds options.final_trials times.
        sets: (n,) each.
        options: of the search.
        tell: takes a line of progress for each set at the end.

    Returns:
        The sets with their results, the best first, JSON values.
    """
    order = np.random.default_rng(options.seed).permutation(len(trials.worlds)).tolist()
    jobs = [(world, trial) for trial in range(options.final_trials) for world in order]
    blocks = [jobs[i : i + FINAL_BLOCK] for i in range(0, len(jobs), FINAL_BLOCK)]
    results, raced = drive_race(trials, np.array(sets), blocks, options.seed, options.price)
    table = [_line(trials.space, np.array(sets[i]), results[i], options.contact_seconds) for i in raced.ranking]
    for line in table:
        tell(f"{_summary(line)}: {line['parameters']}")
    return table


def drive_race(
    trials: SetTrials,
    sets: np.ndarray,
    blocks: Sequence[Sequence[Job]],
    seed: int,
    price: Callable[[TrialResult], float],
    halve: bool = False,
) -> Tuple[List[List[TrialResult]], Result]:
    """Races sets (k, n) through blocks of jobs: the results of each, and how the race ended."""
    results: List[List[TrialResult]] = [[] for _ in sets]

    def drive(racing: List[int], block: Sequence[Job]) -> np.ndarray:
        found = trials.run(sets[racing], block, seed)
        for i, own in zip(racing, found):
            results[i] += own
        return np.array([[price(result) for result in own] for own in found])

    return results, race(drive, len(sets), blocks, halve)


def halving_blocks(jobs: Sequence[Job]) -> List[Sequence[Job]]:
    """The jobs in up to three blocks: a quarter, a second quarter, and the rest."""
    first, second = -(-len(jobs) // 4), -(-len(jobs) // 2)
    return [block for block in (jobs[:first], jobs[first:second], jobs[second:]) if block]


def _line(space: Space, theta: np.ndarray, results: List[TrialResult], contact_seconds: float) -> Dict[str, Any]:
    found = summary(results, contact_seconds)
    names = ("score", "metric", "time_s", "success", "collided", "trials")
    return {**{name: found[name] for name in names}, "theta": theta.tolist(), "parameters": space.as_dict(theta)}


def _summary(line: Dict[str, Any]) -> str:
    return (
        f"{line['score']:.2f} s in {line['trials']} trials (success {line['success']:.3f}, contact "
        f"{line['collided']:.3f}, metric {line['metric']:.3f})"
    )
