"""Drives methods x worlds x trials in a pool of workers, into a folder that can be continued.

evaluate.py and compare_simulators.py call it.
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

from tqdm import tqdm

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.variant import DEFAULT_WEIGHTS, OURS
from applr_ros1.policy import methods
from applr_ros1.robots import JACKAL, Robot
from training.evaluation.store import TRIALS, Store
from training.evaluation.trials import TRIAL_RUNNER, described, plan, world_list
from training.provenance import provenance
from training.workers.pool import Pool, make_pool
from training.workers.tasks import Answer, RunnerSpec, Trial, WorkerSettings
from worlds import World

AHEAD = 8  # finished trials held back per worker, until those before them are done too


class EvaluationError(ApplrError):
    """A trial that cannot be driven; one line."""


@dataclass(frozen=True)
class EvaluationOptions:
    """What to evaluate; evaluate.py's help says what each means."""

    worlds: str = "generated:test"
    methods: str = "dwa,applr"
    trials: int = 20
    simulator: str = "pybullet"
    protocol: str = "paper"
    workers: int = 2
    ray_address: str = ""
    out: str = "results"
    seed: int = 0
    weights: Tuple[str, ...] = (DEFAULT_WEIGHTS,)
    planner: str = OURS
    monitor: bool = False
    as_they_are: bool = False
    traces: int = 1
    runner: str = TRIAL_RUNNER
    robot: Robot = JACKAL


def evaluate(options: EvaluationOptions) -> None:
    """Drives what is missing in the folder options.out.

    Raises:
        ApplrError: with one line; what was driven so far is kept.
    """
    worlds = world_list(options.worlds, options.protocol, options.robot)
    chosen = methods.parse(options.methods, options.robot)
    trials = plan(
        [w[:2] for w in worlds],
        chosen,
        options.trials,
        options.seed,
        options.traces,
        options.weights,
        options.planner,
    )
    store = Store(options.out, settings(options, worlds, chosen), trials)
    try:
        if store.done < len(trials):
            drive(trials, store, options)
    finally:
        store.close()
    print("%d trials in %s" % (len(trials), os.path.join(options.out, TRIALS)))


def settings(
    options: EvaluationOptions, worlds: Sequence[Tuple[str, str, World]], chosen: Sequence[Tuple[str, str]]
) -> Dict[str, Any]:
    """What must not change when an evaluation is continued: goes into evaluation.json."""
    digest = hashlib.sha256()
    for name, _, world in worlds:
        for part in (world.cylinders, world.boxes, world.course.path):
            digest.update(part.tobytes())
        digest.update(repr((name, world.course.start, world.course.goal, world.movers)).encode())
    return {
        "worlds": [name for name, _, _ in worlds],
        "worlds_with_movers": [name for name, _, world in worlds if world.movers],
        "worlds_sha256": digest.hexdigest(),
        "world_specs": [spec for _, spec, _ in worlds],
        "methods": {name: _description(spec, options) for name, spec in chosen},
        "robot": described(options.robot),
        "simulator": options.simulator,
        "protocol": options.protocol,
        "weights": options.weights,
        "planner": options.planner,
        "monitor": options.monitor,
        "as_they_are": options.as_they_are,
        "seed": options.seed,
    }


def _description(spec: str, options: EvaluationOptions) -> Dict[str, Any]:
    """A method's description, with those of what stands for it with these kinds of weights."""
    method = methods.make(spec, options.robot)
    found = {**method.describe(), "period_s": method.period}
    for kind in options.weights:
        other = methods.for_weights(spec, kind, options.robot)
        if other != spec:
            found[kind] = methods.make(other, options.robot).describe()
    return found


def drive(trials: List[Trial], store: Store, options: EvaluationOptions) -> None:
    """Drives what is missing, and appends it in the plan's order."""
    began = time.monotonic()
    workers = min(options.workers, len(trials) - store.done)
    ordered = Ordered(trials, store.done, ahead=AHEAD * workers + 1)
    arguments: Dict[str, Any] = {"simulator": options.simulator, "protocol": options.protocol}
    if options.monitor:
        arguments["monitor"] = True
    if options.as_they_are:
        arguments["as_they_are"] = True
    if options.robot is not JACKAL:  # a worker of one's own need not know of robots
        arguments["robot"] = options.robot.folder
    runner = RunnerSpec(options.runner, arguments)
    pool = make_pool(
        WorkerSettings(trial=runner),
        ordered.next_task,
        workers,
        "ray" if options.ray_address else "processes",
        options.ray_address,
    )
    bar = tqdm(total=len(trials), initial=store.done, unit="trial", dynamic_ncols=True, smoothing=0.05)
    try:
        for answer in ordered.answers(pool):
            trial, result = answer.task, answer.result
            assert isinstance(trial, Trial)
            assert result is not None
            store.append(trial, result, answer.data)
            bar.update()
            how = "%.1f s" % result.time_s if result.success else result.reason
            bar.set_postfix_str("%s %s %s" % (trial.world, trial.method, how), refresh=False)
    finally:
        bar.close()
        pool.close()
        seconds = time.monotonic() - began
        store.finish(seconds, provenance(options.seed), workers=workers, trials=options.trials)


class Ordered:
    """Trials for a pool, and their answers in the plan's order.

    Args:
        trials: the plan.
        first: how many of them are done already.
        ahead: how many trials may be given beyond the first whose answer is not there yet.
    """

    def __init__(self, trials: Sequence[Trial], first: int, ahead: int):
        self.trials, self.ahead = trials, ahead
        self._given = self._out = first

    def next_task(self, slot: int) -> Optional[Trial]:
        """The pool's next_task."""
        if self._given >= min(len(self.trials), self._out + self.ahead):
            return None
        self._given += 1
        return self.trials[self._given - 1]

    def answers(self, pool: Pool) -> Iterator[Answer]:
        """Each answer as soon as all before it are there. Raises EvaluationError where a trial failed by an error."""
        ready: Dict[Trial, Answer] = {}
        while self._out < len(self.trials):
            for answer in pool.poll(1.0):
                assert isinstance(answer.task, Trial)
                if answer.error:
                    raise EvaluationError(
                        "trial %d of %s in %s failed: %s"
                        % (answer.task.trial, answer.task.method, answer.task.world, answer.error)
                    )
                ready[answer.task] = answer
            while self._out < len(self.trials) and self.trials[self._out] in ready:
                yield ready.pop(self.trials[self._out])
                self._out += 1
