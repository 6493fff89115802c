"""The best single set of parameters, by CMA-ES over worlds: the strong rival of a policy. static_search.py calls it.

Each generation drives every candidate through the same freshly drawn worlds with the same seeds; the last generations'
means are then driven through all worlds, and the fastest of them wins.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Any, Callable, Deque, Dict, Iterable, List, Optional, Sequence, Tuple

import cma
import numpy as np

from applr_ros1.common.errors import UsageError
from applr_ros1.common.files import read_json
from applr_ros1.planner.variant import DEFAULT_WEIGHTS, OURS
from applr_ros1.policy.parameter_space import SPACE
from training.evaluation.periodic import CHOOSING
from training.evaluation.score import summary
from training.evaluation.trials import TRIAL_RUNNER, seed_of
from training.workers.pool import PoolError, make_pool
from training.workers.tasks import RunnerSpec, Trial, TrialResult, WorkerSettings

FINALISTS = 3
MANY_ERRORS = 20  # failed trials in one call: something is wrong with all of them


@dataclass(frozen=True)
class SearchOptions:
    """What to search, and how; static_search.py's help says what each means."""

    generations: int
    population: int
    worlds_per_set: int
    start: str
    sigma: float
    seed: int


class SetTrials:
    """Drives sets of parameters through worlds, in parallel.

    Args:
        worlds: [(name, specification), ...].
        simulator: to drive in.
        contact_seconds: what a contact adds to a trial's time in the score [s].
        workers: trials driven at once; 0: in this process.
        pool: "processes" or "ray".
        address: of a Ray cluster, or "".
        weights: how the planner's distance biases count.
        planner: kind of planner (applr_ros1/planner/variant.py).
        runner: "module:Class" that drives the trials.
    """

    def __init__(
        self,
        worlds: Sequence[Tuple[str, str]],
        simulator: str,
        contact_seconds: float = 5.0,
        workers: int = 0,
        pool: str = "processes",
        address: str = "",
        weights: str = DEFAULT_WEIGHTS,
        planner: str = OURS,
        runner: str = TRIAL_RUNNER,
    ):
        self.worlds, self.contact_seconds, self.driven = worlds, contact_seconds, 0
        self.weights, self.planner = weights, planner
        self._queue: Deque[Trial] = deque()
        spec = RunnerSpec(runner, {"simulator": simulator})
        self.pool = make_pool(WorkerSettings(trial=spec), self._next_task, workers, pool, address)

    def _next_task(self, slot: int) -> Optional[Trial]:
        try:
            return self._queue.popleft()
        except IndexError:
            return None

    def run(self, actions: np.ndarray, worlds: Iterable[int], seed: int) -> List[Dict[str, Any]]:
        """Each set (a row of actions (k, 8)) in each of the worlds (indices): a score.summary for each set.

        Raises:
            PoolError: where many trials fail by an error.
        """
        trials = [self._trial(i, action, int(w), seed) for w in worlds for i, action in enumerate(actions)]
        results: Dict[Trial, TrialResult] = {}
        errors = 0
        self._queue.extend(trials)
        while len(results) < len(trials):
            for answer in self.pool.poll(0.2):
                assert isinstance(answer.task, Trial)
                if answer.result is not None:
                    results[answer.task] = answer.result
                    continue
                errors += 1
                if errors > MANY_ERRORS:
                    raise PoolError("trials fail: %s" % answer.error)
                self._queue.append(answer.task)
        self.driven += len(trials)
        of_set = [trials[i :: len(actions)] for i in range(len(actions))]
        return [summary([results[trial] for trial in own], self.contact_seconds) for own in of_set]

    def _trial(self, number: int, action: np.ndarray, world: int, seed: int) -> Trial:
        name, spec = self.worlds[world]
        theta = tuple(float(value) for value in SPACE.to_theta(action))
        seed = seed_of(CHOOSING + seed, name, 0)
        return Trial(name, "set_%d" % number, 0, seed, spec, "", self.weights, self.planner, theta=theta)

    def close(self) -> None:
        """End the workers."""
        self.pool.close()


def search(
    trials: SetTrials,
    worlds: int,
    options: SearchOptions,
    keep: Callable[[List[Dict[str, Any]]], None] = lambda log: None,
) -> Dict[str, Any]:
    """CMA-ES over sets of parameters.

    Args:
        trials: drives the sets.
        worlds: how many worlds there are.
        options: of the search.
        keep: called with the log after each generation.

    Returns:
        {"theta", "result", "log": [a line per generation], "finalists", ...}, JSON values.
    """
    start, log = _start(options.start)
    rng = np.random.default_rng([options.seed, len(log)])
    strategy = cma.CMAEvolutionStrategy(
        np.clip(SPACE.to_action(start), -0.9, 0.9),
        options.sigma,  # not from the very edge of the box
        {"bounds": [-1, 1], "popsize": options.population, "seed": options.seed + 1, "verbose": -9},
    )
    began, last = time.monotonic(), len(log) + options.generations
    for generation in range(len(log), last):
        drawn = np.sort(rng.choice(worlds, min(worlds, options.worlds_per_set), replace=False))
        candidates = strategy.ask()
        results = trials.run(np.array(candidates), drawn.tolist(), seed=options.seed + 1000 + generation)
        strategy.tell(candidates, [r["score"] for r in results])
        best = int(np.argmin([r["score"] for r in results]))
        mean = np.clip(strategy.result.xfavorite, -1.0, 1.0)
        log.append(
            {
                "generation": generation,
                "worlds": drawn.tolist(),
                "sigma": float(strategy.sigma),
                "scores": [round(r["score"], 3) for r in results],
                "best": dict(results[best], **_named(candidates[best])),
                "mean": _named(mean),
                "trials": trials.driven,
                "seconds": round(time.monotonic() - began, 1),
            }
        )
        keep(log)
        print(
            "generation %d of %d: best %.2f s (success %.2f, contact %.2f), median %.2f s, sigma %.3f, "
            "%d trials, %d s"
            % (
                generation + 1,
                last,
                results[best]["score"],
                results[best]["success"],
                results[best]["collided"],
                np.median([r["score"] for r in results]),
                strategy.sigma,
                trials.driven,
                time.monotonic() - began,
            ),
            flush=True,
        )
    finalists = [line["mean"]["theta"] for line in log[-FINALISTS:]] + [log[-1]["best"]["theta"]]
    finalists = [SPACE.theta0.tolist()] + [list(t) for t in dict.fromkeys(map(tuple, finalists))]
    actions = np.array([SPACE.to_action(t) for t in finalists])
    results = trials.run(actions, range(worlds), seed=options.seed)
    best = 1 + int(np.argmin([r["score"] for r in results[1:]]))
    table = [dict(result, **_named(action)) for action, result in zip(actions, results)]
    print(
        "theta_0: %.2f s; best set: %.2f s, success %.3f, contact %.3f, over %d worlds"
        % (results[0]["score"], results[best]["score"], results[best]["success"], results[best]["collided"], worlds)
    )
    return {
        "theta": SPACE.as_dict(SPACE.clip(finalists[best])),
        "result": results[best],
        "theta0": results[0],
        "finalists": table,
        "log": log,
        "trials": trials.driven,
        "seconds": round(time.monotonic() - began, 1),
    }


def _start(path: str) -> Tuple[np.ndarray, List[Dict[str, Any]]]:
    """(theta, log so far) of an earlier search's log, or (theta, []) of a set, or theta_0."""
    if not path:
        return SPACE.theta0, []
    content = read_json(path)
    if not isinstance(content, dict) or "log" not in content:
        return SPACE.read(path), []
    log = content["log"]
    try:
        used = [line["mean"]["theta"] for line in log[-FINALISTS:]] + [log[-1]["best"]["theta"]]
        sets = np.array(used, dtype=np.float64)
    except (TypeError, ValueError, KeyError, IndexError, AttributeError):
        sets = np.empty(0)
    if sets.shape[1:] != (len(SPACE),) or not np.isfinite(sets).all():
        raise UsageError("--start %s: its log holds no generations of sets; give a set or the log of a search" % path)
    return sets[-2], log


def _named(action: np.ndarray) -> Dict[str, Any]:
    theta = SPACE.to_theta(action)
    return {"theta": theta.tolist(), "parameters": SPACE.as_dict(theta)}
