"""Training run: actors drive episodes, one learner learns from them, held-out worlds select the best policy.

The run's folder contains config.json, checkpoint.json with learner-*.pt and replay-*.safetensors, actor.safetensors and
best.safetensors, evaluations.jsonl, evaluation/ and tensorboard/.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, Dict, Optional, Set

import numpy as np
import safetensors.numpy
from tqdm import tqdm

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json, write_json
from applr_ros1.policy import actor
from applr_ros1.policy.dimensionless import ENCODINGS
from training.common.folders import Lock, make_folder
from training.common.provenance import provenance, without_folders
from training.env.trajectory import Trajectory
from training.evaluate.periodic import THETA0, PeriodicEvaluation
from training.evaluate.trial import Result, Trial
from training.train.learner.config import PROVENANCE, TrainConfig
from training.train.learner.prepare import dataset_of, prepare
from training.workers.calls import CallFailed
from training.workers.collect import Collect
from training.workers.pool import Pool

MANY_ERRORS = 20  # number of consecutive failed episodes after which the run ends
LONGEST_EPISODE = (
    2100  # upper bound of the rows of an episode: 100 s at the shortest decision period, .05 s
)
BROADCAST_INTERVAL = 25  # number of gradient steps after which the actors get the latest policy
CHECKPOINT_SECONDS = 120.0  # interval between two checkpoints [s]
STATUS_SECONDS = (
    10.0  # interval between updates of the progress bar's figures and TensorBoard's "training" [s]
)
EPISODE = (
    "return",
    "length",
    "success",
    "collided",
    "time_s",
)  # quantities of an episode in TensorBoard


class TrainingRun:
    """Training run, ready to start with run()."""

    prepare = staticmethod(prepare)

    def __init__(self, config: TrainConfig):
        import torch  # takes seconds; --help and option errors do not import it
        from torch.utils.tensorboard import SummaryWriter

        from training.train.learner.learner import Learner

        self.began = time.monotonic()
        self.preparation = self.prepare(config)
        dataset = dataset_of(config)
        self.offline = dataset is not None
        rows = dataset.rows if dataset else int(1.1 * config.total_timesteps) + LONGEST_EPISODE
        self.config, (action, self.base) = config, config.start
        self.folder = make_folder(config.out)
        self.lock = Lock(self.folder)
        if not config.resume and (self.folder / "config.json").exists():
            raise ApplrError(
                f"{self.folder} already holds a run: continue it with --resume, or give another --out"
            )
        if config.actors and config.ray_address in (
            "",
            "local",
        ):  # More threads than cores are slow.
            torch.set_num_threads(max(1, len(os.sched_getaffinity(0)) - config.actors))
        begin = config.init_from, action, dataset
        self.learner = Learner(self.preparation.layout, config, self.folder, rows, *begin)
        held_out = self.preparation.held_out
        self.evaluation = PeriodicEvaluation(self.folder, held_out, config.eval_freq, config.seed)
        self._next_episode = self.learner.extra.get("next_episode", 0)
        self._running: Set[Future[Any]] = set()  # episodes whose results are not yet added
        self._published, self._policy = (
            0,
            b"",
        )  # version [gradient steps] and weights of the actors' policy
        self._saved = self._shown = time.monotonic()
        self._failed_in_a_row = 0
        self.stopping: Optional[str] = None
        self.pool = Pool(0 if self.offline else config.actors, config.ray_address)
        self.board: Any = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.steps + 1)
        often = (
            1.0 if sys.stderr.isatty() else 30.0
        )  # interval [s]: outside a terminal, each update is a new line
        end = tqdm.format_interval(
            60.0 * config.minutes
        )  # time limit; tqdm's estimate from steps would be hours
        limited = (
            f"{{n_fmt}} steps [{{elapsed}} of {end}, {{rate_fmt}}{{postfix}}]"
            if config.minutes
            else None
        )
        style: Any = {
            "unit": " steps",
            "mininterval": often,
            "dynamic_ncols": True,
            "bar_format": limited,
        }
        self.bar = tqdm(total=self.goal, initial=self.steps, **style)
        path = self.folder / "config.json"
        sessions = read_json(path).get(PROVENANCE, []) if config.resume else []
        sessions.append(provenance(config.seed))
        write_json(
            path, {**config.model_dump(exclude={"resume"}), PROVENANCE: sessions}
        )  # The folder is now a run.

    # -- the run -------------------------------------------------------------------------------------
    @property
    def steps(self) -> int:
        """Steps of the run, evaluations and curves: collected transitions, or gradient steps if offline."""
        return self.learner.td3.updates if self.offline else self.learner.transitions

    @property
    def goal(self) -> int:
        """Total number of steps of the run."""
        return self.config.gradient_steps if self.offline else self.config.total_timesteps

    @property
    def elapsed(self) -> float:
        """Duration of the run without interruptions [s]."""
        return float(self.learner.extra.get("elapsed", 0.0)) + time.monotonic() - self.began

    @property
    def finished(self) -> bool:
        """Return whether all steps are done or the time is up. The last evaluation may still be due."""
        return self.steps >= self.goal or 0.0 < self.config.minutes <= self.elapsed / 60.0

    def run(self) -> int:
        """Train to the end or until SIGINT or SIGTERM; return the exit status, 0 if done, 130 if stopped and saved."""
        handlers = {
            number: signal.signal(number, self._signal)
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        try:
            while not self.finished and not self.stopping:
                self._evaluate()
                if self.offline:
                    for _ in range(min(10, self.goal - self.steps)):
                        self.learner.update()
                self._collect(0.0 if self.offline else 0.2)
                if time.monotonic() - self._saved > CHECKPOINT_SECONDS:
                    self.save()
                self._show_status()
            while self.finished and not self.stopping and self._evaluate():
                pass
            self.save()
        finally:
            self.pool.shutdown()
            self.bar.close()
            self.board.close()
            for number, handler in handlers.items():
                signal.signal(number, handler)
            self.lock.close()
        how = f"Stopped by {self.stopping} and saved" if self.stopping else "Done"
        made = f"{self.learner.transitions:,} transitions and {self.learner.td3.updates:,} updates"
        print(
            f"{how} after {made}, {tqdm.format_interval(time.monotonic() - self.began)}; {self.folder}"
        )
        if self.evaluation.best:
            print(f"best policy: {describe(self.evaluation.best)}")
        return 130 if self.stopping else 0

    def _signal(self, number: int, frame: Any) -> None:
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = signal.Signals(number).name

    def _submit(self) -> None:
        """Submit episodes so that all workers stay busy, unless too many results wait to be added."""
        slots = self.pool.slots
        most = 1 if self.pool.in_process else 4 * slots + 16
        while (
            len(self._running) < most and sum(not future.done() for future in self._running) < slots
        ):
            if self.offline or self.finished:
                return
            config, number, transitions = self.config, self._next_episode, self.learner.transitions
            updates, interval = self.learner.td3.updates, BROADCAST_INTERVAL if config.actors else 1
            if not self._policy or updates >= self._published + interval:
                self._published, self._policy = (
                    updates,
                    safetensors.numpy.save(self.learner.td3.actor_weights()),
                )
            random = transitions < config.learning_starts and not config.init_from
            episode = Collect(number, config.seed, config.noise(transitions), random)
            self._running.add(self.pool.submit(self.preparation.collect, episode, self._policy))
            self._next_episode += 1

    def _collect(self, timeout: float) -> None:
        """Wait for results for at most `timeout` [s], add those that are available, and learn from them."""
        self._submit()
        for future in wait(self._running, timeout, FIRST_COMPLETED).done:
            try:
                trajectory = future.result()
                self._failed_in_a_row = 0
                if not self.finished:
                    self._take(trajectory)
            except CallFailed as error:
                self.bar.write(f"an episode failed: {error}")
                self._failed_in_a_row += 1
                if self._failed_in_a_row >= MANY_ERRORS:
                    raise ApplrError(f"{MANY_ERRORS} episodes in a row failed: {error}") from None
            self._running.remove(future)  # The episode occupies its slot until here.

    def _take(self, trajectory: Trajectory) -> None:
        """Add an episode, and make the gradient steps that are due for it."""
        self.learner.take(trajectory)
        self._scalars("episode", {name: trajectory.info.get(name) for name in EPISODE})
        self._scalars("reward", trajectory.info.get("terms", {}))
        while self.learner.updates_due and not self.stopping:
            self.learner.update()
            self._submit()

    # -- evaluation ------------------------------------------------------------------------------------
    def _evaluate(self) -> bool:
        """Drive a round of the evaluation if one is due, and return whether a round was completed.

        The run is saved first, because an error in a trial ends the run. If the time is limited, the robot's default
        parameters are evaluated last, because this may take minutes. With several seeds, several.py evaluates them.
        """
        limited, finished = self.config.minutes > 0.0, self.finished
        default = self.config.seeds == 1 and (finished or not limited)
        number = self.evaluation.due(self.steps, last=finished and limited, default=default)
        if number is None:
            return False
        self.save()
        weights = self.learner.td3.actor_weights()
        state = {"step": self.steps, "version": self.learner.td3.updates}
        sent = safetensors.numpy.save(weights)
        try:
            summary = self.evaluation.drive(
                number, self.pool, self.preparation.drive, sent, self._end_if_stopped, **state
            )
        except KeyboardInterrupt:  # The completed trials are kept.
            return False
        self.bar.write(describe(summary))
        if summary["best"]:
            self.export(self.folder / "best.safetensors", weights, summary)
        prefix = "default_dwa" if number == THETA0 else "held_out"
        self._scalars(prefix, {name: summary[name] for name in (*EPISODE, "score")})
        return True

    def _end_if_stopped(self, trial: Trial, result: Result) -> None:
        if self.stopping:
            raise KeyboardInterrupt

    # -- files -------------------------------------------------------------------------------------------
    def save(self) -> None:
        """Save a checkpoint and the latest policy."""
        self.learner.save({"elapsed": self.elapsed, "next_episode": self._next_episode})
        self.export(self.folder / "actor.safetensors", self.learner.td3.actor_weights(), None)
        self._saved = time.monotonic()

    def export(
        self, path: Path, weights: Dict[str, np.ndarray], result: Optional[Dict[str, Any]]
    ) -> None:
        """Write a policy for policy/actor.py with metadata of its training, but without folders of this machine."""
        options = self.config.model_dump(exclude={"out", "resume", "ray_address"})
        training = {
            "steps": self.steps,
            "updates": self.learner.td3.updates,
            "transitions": self.learner.transitions,
            "options": {
                k: without_folders(v) if isinstance(v, str) else v for k, v in options.items()
            },
        }
        default = self.evaluation.default if result else None
        period = self.config.decision_period
        self.write_policy(
            path, weights, dict(period_s=period, training=training, result=result, default=default)
        )

    def write_policy(
        self, path: Path, weights: Dict[str, np.ndarray], metadata: Dict[str, Any]
    ) -> None:
        """Write the file of a policy in the encoding of the run."""
        config = self.config
        encoding = ENCODINGS[config.observation](config.robot, config.decision_period, self.base)
        actor.save(path, weights, metadata, encoding)

    # -- progress ------------------------------------------------------------------------------------------
    def _show_status(self) -> None:
        self.bar.update(self.steps - self.bar.n)
        if time.monotonic() - self._shown < STATUS_SECONDS:
            return
        self._shown = time.monotonic()
        learner, infos = self.learner, self.learner.infos
        values = {
            **{
                name: np.mean([info.get(name, np.nan) for info in infos] or [np.nan])
                for name in EPISODE[:-1]
            },
            "sigma": self.config.noise(learner.transitions),
            "updates": learner.td3.updates,
            "actors": len(self.pool.workers),
            "replaced": self.pool.replaced,
            **learner.td3.report(),
        }
        self.bar.set_postfix(
            {name: f"{value:.3g}" for name, value in values.items()}, refresh=False
        )
        self._scalars("training", values)

    def _scalars(self, prefix: str, values: Dict[str, Any]) -> None:
        """Show the finite numbers among `values` in TensorBoard, as prefix/name."""
        for name, value in values.items():
            if value is not None and np.isfinite(value):
                self.board.add_scalar(f"{prefix}/{name}", value, self.steps)


def describe(summary: Dict[str, Any]) -> str:
    """Return a one-line summary of a round of the periodic evaluation."""
    who = "default DWA" if summary["round"] == THETA0 else f"evaluation at {summary['step']:,}"
    time = "-" if summary["time_s"] is None else f"{summary['time_s']:.2f}"
    return (
        f"{who}: return {summary['return']:.2f}, length {summary['length']:.2f}, success {summary['success']:.3f}, "
        f"collision {summary['collided']:.3f}, time {time} s, score {summary['score']:.2f} s "
        f"({summary['trials']} trials){', the best so far' if summary['best'] else ''}"
    )
