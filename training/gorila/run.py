"""A training run from its options to its end: the learner, the workers that drive for it, and the evaluations between.

Online: actors drive episodes, the one learner takes them in and learns (the paper's Gorila). Offline: from a dataset.
The run's folder holds config.json, checkpoint.json with learner-*.safetensors, journal/ (all trajectories), actor and
best .safetensors, episodes.csv, evaluations.jsonl, curves.png, tensorboard/. train.py is its command.
"""

from __future__ import annotations

import json
import signal
import threading
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np
import safetensors.numpy

from applr_ros1.common.files import StorageError, read_bytes, read_json, write_bytes, write_json
from applr_ros1.common.tally import Tally
from applr_ros1.common.tensors import unpack
from applr_ros1.policy import actor
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import load
from training.evaluation.periodic import PeriodicEvaluation
from training.experience.trajectory import Trajectory
from training.gorila.config import PROVENANCE, ConfigError, TrainConfig
from training.gorila.curves import EpisodeLog, draw_curves
from training.gorila.learner import DATASET, Learner
from training.gorila.preparation import dataset_of, learner_config, prepare, set_threads
from training.gorila.progress import ProgressLine, TensorBoardLog, clock, describe, status
from training.gorila.scheduler import TaskScheduler, easiest_first
from training.mdp.rollout import NAVIGATION
from training.provenance import provenance, without_folders
from training.storage import Lock, make_folder
from training.workers.pool import PoolError, make_pool
from training.workers.tasks import Answer, Trial

MANY_ERRORS = 20  # failed episodes in a row: something is wrong with all of them
MANY_REFUSALS = 200  # the same of episodes that the learner does not take; some are normal after a resume


class TrainingRun:
    """A run. run() returns the exit status: 0 done, 130 stopped by a signal and saved."""

    def __init__(self, config: TrainConfig):
        self.began = time.monotonic()
        self.config = config = config.resolved()
        made = prepare(config)
        self.dataset = dataset_of(config, made.layout)
        options = learner_config(config, self.dataset)
        options.td3.check(made.layout.size, made.layout.action, made.layout.scan)
        self.folder = make_folder(config.out)
        self.lock = Lock(self.folder)
        if not config.resume and (self.folder / "config.json").exists():
            raise ConfigError(
                "%s holds a run already: --resume goes on with it, another --out begins a new one" % self.folder
            )
        set_threads(config)
        self.learner = Learner(made.layout, options, self.folder)
        self.extra = self._resume()
        kinds = config.evaluation()
        self.evaluation = PeriodicEvaluation(
            self.folder,
            made.held_out,
            config.eval_trials,
            config.eval_every,
            config.seed,
            config.contact_seconds,
            setting=config.setting(),
            weights=kinds["weights"],
            planner=kinds["planner"],
        )
        self._forget_lost_best()
        worlds = made.train_worlds
        order = easiest_first(worlds) if config.curriculum and worlds else None
        self.scheduler = TaskScheduler(config, len(worlds) if worlds else None, order, self.learner.replay.episodes_of)
        self.scheduler.transitions = self.learner.collected
        self.board = TensorBoardLog(self.folder, self.steps, asdict(config)) if config.tensorboard else None
        self.line = ProgressLine()
        self.stopping: Optional[str] = None
        self.errors = self.refusals = 0  # in a row
        self._published = -1
        self._saved = time.monotonic()
        self._weights: Dict[str, np.ndarray] = {}  # of the policy that the present evaluation drives
        self._known_errors = Tally()
        self.pool = make_pool(
            made.settings,
            self.scheduler.next_task,
            0 if self.offline else config.actors,
            config.pool,
            config.ray_address,
        )
        self._write_config()  # from now on it is a run

    def _write_config(self) -> None:
        """config.json: the options, and where each session of the run comes from."""
        path, config = self.folder / "config.json", self.config
        before = read_json(path).get(PROVENANCE, []) if config.resume else []
        write_json(path, {**asdict(config), "resume": False, PROVENANCE: [*before, provenance(config.seed)]})

    def _resume(self) -> Dict[str, Any]:
        """Back to where the run was: the checkpoint, and every trajectory taken since."""
        checkpoint = Learner.saved(self.folder) if self.config.resume else None
        self.episodes = EpisodeLog(self.folder, Learner.collected_in(checkpoint) if checkpoint else 0)
        if not self.config.resume:
            return {}
        began_with = checkpoint["extra"].get("dataset") if checkpoint else None  # earlier versions did not note it
        if self.dataset is not None and began_with not in (None, self.dataset.digest):
            raise ConfigError(
                "--dataset %s: the run in %s was begun with another dataset (its checksum differs): give that one, or "
                "begin a new run with another --out" % (self.config.dataset, self.folder)
            )
        return self.learner.resume(self._taken_again, self.offline)

    def _taken_again(self, learner: Learner, trajectory: Trajectory) -> None:
        """An episode that the journal holds behind the checkpoint."""
        if trajectory.info["actor"] != DATASET:
            self.episodes.add(learner.collected, trajectory.info)

    # -- the run -------------------------------------------------------------------------------------
    @property
    def offline(self) -> bool:
        """Whether it learns from a dataset alone."""
        return self.dataset is not None and not self.config.mix

    @property
    def steps(self) -> int:
        """What --steps, evaluations, curves and TensorBoard count: collected transitions; offline: gradient steps."""
        return self.learner.td3.updates if self.offline else self.learner.collected

    @property
    def elapsed(self) -> float:
        """Seconds that the run has taken, interruptions not counted."""
        return float(self.extra.get("elapsed", 0.0)) + time.monotonic() - self.began

    @property
    def goal(self) -> int:
        """How many steps the run has in all."""
        return self.config.updates if self.offline else self.config.steps

    @property
    def seconds_left(self) -> float:
        """Seconds until --minutes are over; infinite where the run has no such limit."""
        return 60.0 * self.config.minutes - self.elapsed if self.config.minutes else float("inf")

    @property
    def finished(self) -> bool:
        """Whether all steps are done, or the time is up; the last evaluation may still be open."""
        return self.steps >= self.goal or self.seconds_left <= 0.0

    def run(self) -> int:
        """Trains to the end, or until SIGINT or SIGTERM."""
        handlers = {}
        if threading.current_thread() is threading.main_thread():
            handlers = {number: signal.signal(number, self._signal) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            self._take_dataset()
            self._catch_up()
            self._publish()
            while not self.finished and not self.stopping:
                self._one_turn()
            while self.finished and not self.stopping and (self.evaluation.number is not None or self._evaluate()):
                self._collect(0.2)
            self.save()
            draw_curves(self.folder / "curves.png", self.episodes, self.evaluation, self.config.period)
        finally:
            self.pool.close()
            self.line.close()
            if self.board:
                self.board.close()
            for number, handler in handlers.items():
                signal.signal(number, handler)
            self.lock.close()
        self._print_the_end()
        return 130 if self.stopping else 0

    def _catch_up(self) -> None:
        """Makes the gradient steps that are due before anything is driven: for a dataset, or after a resume."""
        while not self.offline and self.learner.updates_due and not self.stopping and self.seconds_left > 0.0:
            self.learner.train(10)
            self._save_now_and_then()
            self._show_status()

    def _save_now_and_then(self) -> None:
        if time.monotonic() - self._saved > self.config.checkpoint_every:
            self.save()

    def _one_turn(self) -> None:
        """Take what came in, make the gradient steps that are due for it, and whatever else is due."""
        self._evaluate()
        if self.offline:
            for _ in range(min(10, self.config.updates - self.learner.td3.updates)):
                self.learner.update()
            if self.evaluation.number is not None:
                self._collect(0.0)
        else:
            self._collect(0.2)
        self._publish()
        self._save_now_and_then()
        self._show_status()

    def _collect(self, timeout: float) -> None:
        for answer in self.pool.poll(timeout):
            if self.stopping:
                return
            if answer.error:
                self._failed(answer.error)
            else:
                self.errors = 0
            if isinstance(answer.task, Trial):
                self._trial_done(answer)
            elif not answer.error and not self.offline and not self.finished:
                trajectory = self.learner.take(answer.data)
                if trajectory is not None:
                    self._taken(trajectory)
                else:
                    self._refused()

    def _taken(self, trajectory: Trajectory) -> None:
        self.refusals = 0
        self.episodes.add(self.learner.collected, trajectory.info)
        self.scheduler.transitions = self.learner.collected
        if self.board:
            self.board.episode(trajectory.info, self.steps)
        while self.learner.updates_due and not self.stopping:
            self.learner.train(10)
            self._publish()

    def _failed(self, text: str) -> None:
        """An episode ended by an error: counted, printed once, and too many in a row end the run."""
        if self._known_errors.add(text):
            self.line.say("an episode failed: %s" % text)
        self.errors += 1
        if self.errors >= MANY_ERRORS:
            raise PoolError("%d episodes in a row failed, the last with %s" % (self.errors, text))

    def _refused(self) -> None:
        """The learner did not take an episode. Too many in a row end the run: it would learn nothing any more."""
        self.refusals += 1
        if self.refusals >= MANY_REFUSALS:
            raise PoolError("%d episodes in a row were refused: %s" % (self.refusals, self.learner.refused.commonest))

    def _publish(self) -> None:
        updates = self.learner.td3.updates
        if (
            self._published < 0
            or updates >= self._published + self.config.publish_every
            or self.config.actors == 0
            and updates != self._published
        ):
            self.pool.publish(updates, safetensors.numpy.save(self.learner.td3.actor_weights()))
            self._published = updates
            self.scheduler.ready = True

    def _take_dataset(self) -> None:
        if self.dataset is None:
            return
        known = self.learner.replay.episodes_of(DATASET)  # a resumed run has them already
        for i, trajectory in enumerate(self.dataset):
            if i < known:
                continue
            trajectory.info = dict(trajectory.info, actor=DATASET, episode=i, version=self.learner.td3.updates)
            self.learner.take(trajectory.pack())
        if self.learner.replay.episodes_of(DATASET) > known:
            self.save()  # what is learnt from here on begins with the whole dataset, also after a kill

    # -- evaluation ------------------------------------------------------------------------------------
    def _evaluate(self) -> bool:
        """Begins a round of the evaluation if one is due."""
        number = self.evaluation.due(self.steps)
        if number is None:
            return False
        self._weights = self.learner.td3.actor_weights()
        self.pool.pin_for_evaluation(self.learner.td3.updates, safetensors.numpy.save(self._weights))
        self.scheduler.evaluate(self.evaluation.begin(number, self.steps, self.learner.td3.updates))
        return True

    def _trial_done(self, answer: Answer) -> None:
        summary = self.evaluation.add(answer)
        if summary is None:
            return
        self.line.say(describe(summary))
        if summary["best"]:
            self.export(self.folder / "best.safetensors", self._weights, summary)
        if self.board:
            self.board.round(summary)
        draw_curves(self.folder / "curves.png", self.episodes, self.evaluation, self.config.period)

    def _forget_lost_best(self) -> None:
        """Has the last round driven again where the run was killed before it kept the policy that was its best."""
        rounds, path = self.evaluation.history, self.folder / "best.safetensors"
        if not (rounds and rounds[-1]["best"]):
            return
        try:
            result = unpack(read_bytes(path), str(path), StorageError)[1].get("result")
        except StorageError:  # absent or damaged
            result = None
        if result != json.dumps(rounds[-1]):
            self.evaluation.history = rounds[:-1]

    # -- files -------------------------------------------------------------------------------------------
    def save(self) -> None:
        """A checkpoint, and the newest policy."""
        noted = {} if self.dataset is None else {"dataset": self.dataset.digest}
        self.learner.save({"elapsed": self.elapsed, **noted})
        self.export(self.folder / "actor.safetensors", self.learner.td3.actor_weights(), None)
        self._saved = time.monotonic()

    def export(self, path: Path, weights: Dict[str, np.ndarray], result: Optional[Dict[str, Any]]) -> None:
        """The policy as policy/actor.py reads it, with what trained it; but nothing of this machine's folders."""
        options = {
            k: without_folders(v) if isinstance(v, str) else v
            for k, v in asdict(self.config).items()
            if k not in ("out", "resume", "ray_address")
        }
        metadata = {
            "period_s": self.config.period,
            "training": {
                "steps": self.steps,
                "updates": self.learner.td3.updates,
                "transitions": self.learner.transitions,
                "options": options,
            },
            "result": result,
            "default": self.evaluation.default if result else None,
        }
        if self.config.env == NAVIGATION:
            robot = load(self.config.robot)
            actor.save(path, weights, metadata, space_of(robot), layout_of(robot))
        else:
            write_bytes(path, safetensors.numpy.save(weights, {k: json.dumps(v) for k, v in metadata.items()}))

    # -- progress ------------------------------------------------------------------------------------------
    def _show_status(self) -> None:
        if not self.line.due():
            return
        learner, done = self.learner, "updates" if self.offline else "transitions"
        counts = {"transitions": learner.collected, "updates": learner.td3.updates}
        rates = self.line.rates(time.monotonic(), counts)
        values = {
            **{name: self.episodes.recent(name) for name in ("return", "length", "success", "collided")},
            "sigma": self.config.noise(learner.collected),
            **{name + "_per_second": rate for name, rate in rates.items()},
            "staleness_mean": learner.staleness.mean,
            "staleness_max": learner.staleness.most,
            "actors": self.pool.alive,
            "replaced": self.pool.replaced,
            "refused": sum(learner.refused.values()),
            **learner.td3.report(),
        }
        self.line.show(status(done, counts[done], self.goal, values, self.seconds_left))
        if self.board:
            self.board.scalars("training", values, self.steps)

    def _print_the_end(self) -> None:
        print(
            "%s after %s transitions and %s updates, %s; %s"
            % (
                "Stopped by %s and saved" % self.stopping if self.stopping else "Done",
                format(self.learner.transitions if self.offline else self.steps, ","),
                format(self.learner.td3.updates, ","),
                clock(time.monotonic() - self.began),
                self.folder,
            )
        )
        if self.evaluation.best:
            print("best actor: %s" % describe(self.evaluation.best))
        for reason, count in sorted(self.learner.refused.items()):
            print("refused %d trajectories: %s" % (count, reason))

    def _signal(self, number: int, frame: Any) -> None:
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = signal.Signals(number).name
