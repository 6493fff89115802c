"""Training run: actors drive episodes, one learner learns, held-out worlds select the best policy.

The run's folder contains config.json, checkpoint.json with learner-*.pt and replay-*.safetensors,
actor.safetensors and best.safetensors, evaluations.jsonl, evaluation/ and tensorboard/.
"""

from __future__ import annotations

import os
import shutil
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
from applr_ros1.drives.end_rules import TIME_LIMIT
from applr_ros1.policy import actor
from applr_ros1.policy.dimensionless import ENCODINGS
from applr_ros1.stack.simulated import CONTROL_PERIOD
from training.common.command_line import robot_name
from training.common.folders import Lock
from training.common.provenance import provenance, without_folders
from training.env.trajectory import Trajectory
from training.evaluate.bound import NEAR, bound_s
from training.evaluate.periodic import PeriodicEvaluation
from training.evaluate.score import in_words
from training.evaluate.trial import BASELINE, Result, Trial
from training.train.learner.config import PROVENANCE, TrainConfig
from training.train.learner.prepare import dataset_of, prepare
from training.train.learner.several import VERDICT
from training.train.replay.dataset import describe as describe_dataset
from training.workers.calls import CallFailed
from training.workers.collect import Collect
from training.workers.pool import Pool

MANY_ERRORS = 20  # number of consecutive failed episodes after which the run ends
# Upper bound of the rows of an episode: one for each decision at the shortest period, and one more
LONGEST_EPISODE = round(TIME_LIMIT / CONTROL_PERIOD) + 1
BROADCAST_INTERVAL = 25  # number of gradient steps after which the actors get the latest policy
WAIT_SECONDS = 0.2  # longest wait for an episode, after which signals are looked at [s]
CHECKPOINT_SECONDS = 120.0  # interval between two checkpoints [s]
# Interval between updates of the progress bar's figures and TensorBoard's "training" [s]
STATUS_SECONDS = 10.0
# Quantities of an episode in TensorBoard
EPISODE = ("return", "length", "success", "collided", "time_s")


class TrainingRun:
    """Training run, ready to start with run()."""

    prepare = staticmethod(prepare)

    def __init__(self, config: TrainConfig):
        import torch  # takes seconds; --help and option errors do not import it
        from torch.utils.tensorboard import SummaryWriter

        from training.train.learner.learner import Learner

        self.began = time.monotonic()
        self.config = config
        self.preparation = self.prepare(config)
        dataset = dataset_of(config)
        self.offline = dataset is not None
        if dataset:
            rows = dataset.rows
            driven_seconds = dataset.transitions * config.decision_period
            print(f"{config.dataset}: {describe_dataset(dataset.transitions, driven_seconds)}")
        else:
            # A row more per episode than transitions, with some to spare: an episode has 13.
            rows = int(1.1 * config.total_timesteps) + LONGEST_EPISODE
        action, self.base = config.start

        is_new = not Path(config.out).exists()
        self.folder = config.folder()
        # A second process would overwrite the checkpoints of the first.
        self.lock = Lock(self.folder)

        # Learner and evaluation
        actors = 0 if self.offline else config.actors
        if actors and config.ray_address in ("", "local"):
            # The actors' processes need the other cores: more threads than cores are slow.
            torch.set_num_threads(max(1, len(os.sched_getaffinity(0)) - actors))
        try:
            self.learner = Learner(
                self.preparation.layout,
                config,
                self.folder,
                rows,
                init_from=config.init_from,
                robot=config.robot,
                action=action,
                dataset=dataset,
            )
        except BaseException:
            # A start that is refused leaves nothing behind: the folder has only the lock so far.
            self.lock.close()
            if is_new:
                shutil.rmtree(self.folder)
            raise
        held_out = self.preparation.held_out
        self.evaluation = PeriodicEvaluation(
            self.folder, held_out, config.eval_freq, config.seed, bool(config.init_from)
        )

        # Episodes being driven
        self._next_episode = self.learner.extra.get("next_episode", 0)
        self._running: Set[Future[Any]] = set()  # episodes whose results are not yet added
        self._published = 0  # version of the actors' policy [gradient steps]
        self._policy = b""  # weights of the actors' policy
        self._saved = time.monotonic()  # time of the last checkpoint
        self._shown = self._saved  # time of the last figures in the progress bar
        self._failed_in_a_row = 0
        self.stopping: Optional[str] = None
        self.pool = Pool(actors, "" if self.offline else config.ray_address)

        # Progress: curves after the checkpoint are those of a run that was killed.
        self.board: Any = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.steps + 1)
        self.bar = self._make_bar()

        # The folder is now a run.
        path = self.folder / "config.json"
        sessions = read_json(path).get(PROVENANCE, []) if config.resume else []
        sessions.append(provenance(config.seed))
        write_json(path, {**config.model_dump(exclude={"resume"}), PROVENANCE: sessions})

    def _make_bar(self) -> tqdm[Any]:
        """Return the progress bar."""
        style: Dict[str, Any] = {"unit": " steps", "dynamic_ncols": True}
        # Interval [s]: outside a terminal, each update is a new line.
        style["mininterval"] = 1.0 if sys.stderr.isatty() else 30.0
        if self.config.minutes:
            # The time limit, because tqdm's estimate from the steps would be hours
            limit = tqdm.format_interval(60.0 * self.config.minutes)
            style["bar_format"] = (
                f"{{n_fmt}} steps [{{elapsed}} of {limit}, {{rate_fmt}}{{postfix}}]"
            )
        return tqdm(total=self.goal, initial=self.steps, **style)

    # -- the run -----------------------------------------------------------------------------------
    @property
    def steps(self) -> int:
        """Steps of the run and its curves: collected transitions, or gradient steps if offline."""
        if self.offline:
            return self.learner.td3.updates
        return self.learner.transitions

    @property
    def goal(self) -> int:
        """Total number of steps of the run."""
        if self.offline:
            return self.config.gradient_steps
        return self.config.total_timesteps

    @property
    def elapsed(self) -> float:
        """Duration of the run without interruptions [s]."""
        return float(self.learner.extra.get("elapsed", 0.0)) + time.monotonic() - self.began

    @property
    def finished(self) -> bool:
        """Return whether the steps are done or the time is up; an evaluation may still be due."""
        return self.steps >= self.goal or 0.0 < self.config.minutes <= self.elapsed / 60.0

    def run(self) -> int:
        """Train to the end or until SIGINT or SIGTERM.

        Returns:
            The exit status: 0 if done, 130 if stopped and saved.
        """
        handlers = {}
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, self._signal)
        try:
            while not self.finished and not self.stopping:
                self._evaluate()
                if self.offline:
                    # Few steps at a time, so that a signal stops the run soon.
                    for _ in range(min(10, self.goal - self.steps)):
                        self.learner.update()
                else:
                    self._collect()
                if time.monotonic() - self._saved > CHECKPOINT_SECONDS:
                    self.save()
                self._show_status()
            # The last round may still be due.
            if not self.stopping:
                self._evaluate()
            self.save()
        finally:
            self.pool.shutdown()
            self.bar.close()
            self.board.close()
            for number, handler in handlers.items():
                signal.signal(number, handler)
            self.lock.close()
        status = 0
        end = "Done"
        if self.stopping:
            status = 130  # 128 + SIGINT, as a shell reports it
            end = f"Stopped by {self.stopping} and saved"
        updates = f"{self.learner.td3.updates:,} updates"
        duration = tqdm.format_interval(time.monotonic() - self.began)
        transitions = f"{self.learner.transitions:,} transitions"
        print(f"{end} after {transitions} and {updates}, {duration}; {self.folder}")
        if self.evaluation.best:
            print(f"best policy: {describe(self.evaluation.best)}")
        # Several seeds are judged together.
        if self.config.seeds == 1:
            robot = robot_name(self.config.robot)
            print(
                f"to judge the policy: ./applr evaluate --robot {robot} --methods dwa,"
                f"{self.policy_file} --worlds {VERDICT} --trials 1 --monitor --out DIR"
            )
        return status

    @property
    def policy_file(self) -> Path:
        """File of the best policy, or of the latest one if no evaluation has chosen one."""
        return self.folder / ("best.safetensors" if self.evaluation.best else "actor.safetensors")

    def _signal(self, number: int, frame: Any) -> None:
        """Ask the run to stop after the current step.

        A second signal ends it at once.
        """
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = signal.Signals(number).name

    def _submit(self) -> None:
        """Submit episodes so that all workers stay busy, unless many results wait to be added."""
        slots = self.pool.slots
        # Results that wait hold memory, and the policies that made them grow old.
        limit = 4 * slots + 16
        if self.pool.in_process:
            limit = 1
        while not self.finished:
            unfinished = sum(not future.done() for future in self._running)
            if len(self._running) >= limit or unfinished >= slots:
                return
            self._publish()
            config = self.config
            transitions = self.learner.transitions
            # A policy that has been learnt explores better than random actions.
            random = transitions < config.learning_starts and not config.init_from
            noise = config.noise(transitions)
            episode = Collect(self._next_episode, config.seed, noise, random)
            future = self.pool.submit(self.preparation.collect, episode, self._policy)
            self._running.add(future)
            self._next_episode += 1

    def _publish(self) -> None:
        """Give the actors the latest policy if theirs is BROADCAST_INTERVAL gradient steps old."""
        updates = self.learner.td3.updates
        # Without actors nothing is sent, and each episode is driven by the latest policy.
        interval = BROADCAST_INTERVAL if self.config.actors else 1
        if not self._policy or updates >= self._published + interval:
            self._published = updates
            self._policy = safetensors.numpy.save(self.learner.td3.actor_weights())

    def _collect(self) -> None:
        """Wait WAIT_SECONDS for results, add those that are available, and learn from them."""
        self._submit()
        for future in wait(self._running, WAIT_SECONDS, FIRST_COMPLETED).done:
            try:
                trajectory = future.result()
                self._failed_in_a_row = 0
                if not self.finished:
                    self._take(trajectory)
            except CallFailed as error:
                # One simulator that fails must not end a training of days; a fault of all ends it.
                self.bar.write(f"an episode failed: {error}")
                self._failed_in_a_row += 1
                if self._failed_in_a_row >= MANY_ERRORS:
                    raise ApplrError(f"{MANY_ERRORS} episodes in a row failed: {error}") from None
            self._running.remove(future)  # The episode occupies its slot until here.

    def _take(self, trajectory: Trajectory) -> None:
        """Add an episode, and make the gradient steps that are due for it."""
        self.learner.add_trajectory(trajectory)
        self._scalars("episode", {name: trajectory.info.get(name) for name in EPISODE})
        self._scalars("reward", trajectory.info.get("terms", {}))
        while self.learner.updates_due and not self.stopping:
            self.learner.update()
            self._submit()  # The actors must not wait for the end of the gradient steps.

    # -- evaluation --------------------------------------------------------------------------------
    def _evaluate(self) -> None:
        """Drive a round of the evaluation if one is due.

        The run is saved first, because an error in a trial ends the run.
        """
        is_last = self.finished and self.config.minutes > 0.0
        number = self.evaluation.due(self.steps, last=is_last)
        if number is None:
            return
        self.save()
        weights = self.learner.td3.actor_weights()
        try:
            summary = self.evaluation.drive(
                number,
                self.pool,
                self.preparation.drive,
                safetensors.numpy.save(weights),
                self._end_if_stopped,
                step=self.steps,
                version=self.learner.td3.updates,
            )
        except KeyboardInterrupt:
            return  # The completed trials are kept.
        self.bar.write(describe(summary))
        if summary["best"]:
            self.export(self.folder / "best.safetensors", weights, summary)
        prefix = "default_dwa" if summary["method"] == BASELINE else "held_out"
        self._scalars(prefix, {name: summary[name] for name in (*EPISODE, "score")})
        action, _ = self.config.start
        if action is not None and not self.steps:
            self._compare_with_bound(summary["score"])

    def _compare_with_bound(self, score: float) -> None:
        """Say how far above the bound the parameter set is with which the run begins."""
        bounds = [bound_s(world, self.config.robot) for _, _, world in self.preparation.held_out]
        bound = np.mean(bounds)
        is_near = score <= NEAR * bound
        room = "within a tenth, no policy is needed" if is_near else "a policy has room"
        self.bar.write(f"{self.config.init_from}: score {score:.2f} s, bound {bound:.2f} s: {room}")

    def _end_if_stopped(self, trial: Trial, result: Result) -> None:
        """Interrupt the evaluation after a trial if the run is to stop."""
        if self.stopping:
            raise KeyboardInterrupt

    # -- files -------------------------------------------------------------------------------------
    def save(self) -> None:
        """Save a checkpoint and the latest policy."""
        self.learner.save({"elapsed": self.elapsed, "next_episode": self._next_episode})
        self.export(self.folder / "actor.safetensors", self.learner.td3.actor_weights(), None)
        self._saved = time.monotonic()

    def export(
        self, path: Path, weights: Dict[str, np.ndarray], result: Optional[Dict[str, Any]]
    ) -> None:
        """Write a policy for policy/actor.py with metadata of its training.

        The metadata contain no folders of this machine, because policies are passed on.
        """
        options = self.config.model_dump(exclude={"out", "resume", "ray_address"})
        for name, value in options.items():
            if isinstance(value, str):
                options[name] = without_folders(value)
        training = {
            "steps": self.steps,
            "updates": self.learner.td3.updates,
            "transitions": self.learner.transitions,
            "options": options,
        }
        metadata = {
            "period_s": self.config.decision_period,
            "training": training,
            "result": result,
            "start": self.evaluation.history[0] if result else None,
        }
        self.write_policy(path, weights, metadata)

    def write_policy(
        self, path: Path, weights: Dict[str, np.ndarray], metadata: Dict[str, Any]
    ) -> None:
        """Write the file of a policy in the encoding of the run."""
        config = self.config
        encoding = ENCODINGS[config.observation](config.robot, config.decision_period, self.base)
        if config.obstacle_range is not None:
            metadata["obstacle_range"] = config.obstacle_range
        actor.save(path, weights, metadata, encoding)

    # -- progress ----------------------------------------------------------------------------------
    def _show_status(self) -> None:
        """Update the progress bar, and every STATUS_SECONDS its figures and TensorBoard's."""
        self.bar.update(self.steps - self.bar.n)
        if time.monotonic() - self._shown < STATUS_SECONDS:
            return
        self._shown = time.monotonic()
        learner = self.learner
        values: Dict[str, Any] = {}
        for name in EPISODE:
            # In the mean time, failed episodes would count with their time limits.
            if name == "time_s":
                continue
            latest = [info.get(name, np.nan) for info in learner.infos]
            values[name] = np.mean(latest or [np.nan])
        values["updates"] = learner.td3.updates
        if not self.offline:
            values["sigma"] = self.config.noise(learner.transitions)
            values["actors"] = len(self.pool.workers)
            values["replaced"] = self.pool.replaced
        values.update(learner.td3.report())
        figures = _finite(values)
        self.bar.set_postfix(
            {name: f"{value:.3g}" for name, value in figures.items()}, refresh=False
        )
        self._scalars("training", values)

    def _scalars(self, prefix: str, values: Dict[str, Any]) -> None:
        """Show the finite numbers among `values` in TensorBoard, as prefix/name."""
        for name, value in _finite(values).items():
            self.board.add_scalar(f"{prefix}/{name}", value, self.steps)


def _finite(values: Dict[str, Any]) -> Dict[str, float]:
    """Return the finite numbers among some values."""
    numbers = {}
    for name, value in values.items():
        if value is not None and np.isfinite(value):
            numbers[name] = value
    return numbers


def describe(summary: Dict[str, Any]) -> str:
    """Return a one-line summary of a round of the periodic evaluation."""
    name = f"evaluation at {summary['step']:,}"
    if summary["method"] == BASELINE:
        name = "default DWA"
    elif not summary["step"]:
        name = "before learning"
    best = ", the best so far" if summary["best"] else ""
    return f"{name}: {in_words(summary)}{best}"
