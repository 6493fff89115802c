"""Training with one command: `python -m training.train`, or `rosrun applr_ros1 train.py`.

Online, actors drive episodes and one learner learns from them (the paper's Gorila architecture). Offline, the learner
learns from a dataset. The run's folder holds config.json, checkpoint.json with learner-*.safetensors, journal/ with all
trajectories, actor.safetensors and best.safetensors, episodes.csv, evaluations.jsonl, curves.png and tensorboard/.
docs/training.md describes all of it.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from dataclasses import asdict
from typing import Dict, List, Optional

import safetensors.numpy

from applr_ros1.common.errors import run_main
from applr_ros1.common.files import write_bytes, write_json
from training.evaluation.periodic import Episodes, Rounds, draw_curves
from training.experience.dataset import Dataset, DatasetError
from training.gorila.actor_pool import InProcess, Pool, PoolError, Processes, RayPool
from training.gorila.config import ConfigError, TrainConfig, parse
from training.gorila.console import Board, ProgressLine, clock, describe
from training.gorila.learner import Learner
from training.gorila.tasks import Tasks, easiest_first, spread
from training.gorila.worker import RESULT, TRAJECTORY, layout_of
from training.storage import Lock, make_folder

OURS = TrainConfig.env
MANY_ERRORS = 20  # failed episodes in a row: something is wrong with all of them


class Training:
    """A run from its options to its end. run() returns the exit status."""

    def __init__(self, config: TrainConfig):
        self.began = time.monotonic()
        self.config = config = config.resolved()
        settings, train_worlds, test_worlds, layout = prepare(config)
        self.layout = layout
        dataset = Dataset(config.dataset, layout) if config.dataset else None
        self.folder = make_folder(config.out)
        self.lock = Lock(self.folder)
        if not config.resume and (self.folder / "config.json").exists():
            raise ConfigError(
                "%s holds a run already: --resume goes on with it, another --out begins a new one" % self.folder
            )
        set_threads(config)
        self.learner = Learner(layout, _with_rows(config, dataset), self.folder)
        self.dataset = dataset
        self.extra = self._resume() if config.resume else {}
        self.episodes = self.episodes if config.resume else Episodes(self.folder, 0)
        self.rounds = Rounds(
            self.folder,
            spread(test_worlds, config.eval_count),
            config.eval_trials,
            config.eval_every,
            config.seed,
            config.contact_seconds,
            setting=", ".join([config.eval_worlds, *config.evaluation().values()]),
        )
        order = easiest_first(train_worlds) if config.curriculum and train_worlds else None
        self.tasks = Tasks(config, len(train_worlds) if train_worlds else None, order, self.learner.replay.episodes_of)
        self.tasks.transitions = self.learner.transitions
        self.board = Board(self.folder, self.steps) if config.tensorboard else None
        self.line = ProgressLine()
        self.stopping: Optional[str] = None
        self.errors = 0
        self._published = -1
        self._saved = time.monotonic()
        self._episode_errors: Dict[str, int] = {}
        self.pool = self._make_pool(settings)
        write_json(self.folder / "config.json", dict(asdict(config), resume=False))  # from now on it is a run

    def _resume(self):
        """Back to where the run was: the checkpoint, and every trajectory taken since."""
        checkpoint = Learner.saved(self.folder)
        self.episodes = Episodes(self.folder, checkpoint["episodes"] if checkpoint else 0)
        return self.learner.resume(lambda learner, t: self.episodes.add(learner.transitions, t.info))

    def _make_pool(self, settings) -> Pool:
        c = self.config
        if c.actors == 0 or self.offline:
            return InProcess(settings, self.tasks.next)
        if c.pool == "processes":
            return Processes(settings, self.tasks.next, c.actors)
        return RayPool(settings, self.tasks.next, c.actors, c.ray_address or None)

    # -- the run -------------------------------------------------------------------------------------
    @property
    def offline(self) -> bool:
        return self.dataset is not None and not self.config.mix

    @property
    def steps(self) -> int:
        """What evaluations, curves and TensorBoard are counted in."""
        return self.learner.td3.updates if self.offline else self.learner.transitions

    @property
    def finished(self) -> bool:
        c, learner = self.config, self.learner
        return learner.td3.updates >= c.updates if self.offline else learner.transitions >= c.steps

    def run(self) -> int:
        previous = (
            {number: signal.signal(number, self._signal) for number in (signal.SIGINT, signal.SIGTERM)}
            if _main_thread()
            else {}
        )
        try:
            self._take_dataset()
            while (
                not self.offline and self.learner.updates_due and not self.stopping
            ):  # for a dataset, or after a resume
                self.learner.train(10)
                self._say()
            self._publish()
            while not self.finished and not self.stopping:
                self._one_turn()
            while self.finished and not self.stopping and (self.rounds.number is not None or self._begin_round()):
                self._collect(0.2)
            self.save()
            draw_curves(self.folder / "curves.png", self.episodes, self.rounds)
        finally:
            self.pool.close()
            self.line.close()
            if self.board:
                self.board.close()
            for number, handler in previous.items():
                signal.signal(number, handler)
        self._say_the_end()
        return 130 if self.stopping else 0

    def _one_turn(self) -> None:
        """Take what came in, learn what that owes, and see to everything that is due."""
        self._begin_round()
        if self.offline:
            for _ in range(min(10, self.config.updates - self.learner.td3.updates)):
                self.learner.update()
            if self.rounds.number is not None:
                self._collect(0.0)
        else:
            self._collect(0.2)
        self._publish()
        if time.monotonic() - self._saved > self.config.checkpoint_every:
            self.save()
        self._say()

    def _collect(self, timeout: float) -> None:
        for answer in self.pool.poll(timeout):
            if self.stopping:
                return
            if answer[:1] == TRAJECTORY and not self.offline:
                if self.finished:
                    continue
                trajectory = self.learner.take(answer[1:])
                if trajectory is not None:
                    self._taken(trajectory)
            elif answer[:1] == RESULT:
                result = json.loads(answer[1:])
                if self.tasks.done(result["task"]):
                    self._round_goes_on(result)
            elif answer[:1] not in (TRAJECTORY, RESULT):
                self._failed(json.loads(answer[1:]))

    def _taken(self, trajectory) -> None:
        self.errors = 0
        self.episodes.add(self.learner.transitions, trajectory.info)
        self.tasks.transitions = self.learner.transitions
        while self.learner.updates_due and not self.stopping:
            self.learner.train(10)
            self._publish()

    def _failed(self, answer) -> None:
        """An episode ended by an error: counted, said once, and too many in a row end the run."""
        text = str(answer.get("error"))
        if text not in self._episode_errors:
            self.line.say("an episode failed: %s" % text)
        self._episode_errors[text] = self._episode_errors.get(text, 0) + 1
        self.errors += 1
        if self.errors >= MANY_ERRORS:
            raise PoolError("%d episodes in a row failed, the last with %s" % (self.errors, text))
        task = answer.get("task", {})
        if task.get("kind") == "evaluate" and self.tasks.done(task):
            self._round_goes_on(None)

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

    def _take_dataset(self) -> None:
        if self.dataset is None:
            return
        known = self.learner.replay.episodes_of("dataset")  # a resumed run has them already
        for i, trajectory in enumerate(self.dataset):
            if i < known:
                continue
            trajectory.info = dict(trajectory.info, actor="dataset", episode=i, version=self.learner.td3.updates)
            self.learner.take(trajectory.pack())
        if not self.learner.transitions:
            raise DatasetError("%s: holds no transitions" % self.config.dataset)

    # -- evaluation ------------------------------------------------------------------------------------
    def _begin_round(self) -> bool:
        number = self.rounds.due(self.steps)
        if number is None:
            return False
        self._weights = self.learner.td3.actor_weights()
        self.pool.keep(self.learner.td3.updates, safetensors.numpy.save(self._weights))
        self.tasks.evaluate(self.rounds.begin(number, self.steps, self.learner.td3.updates))
        return True

    def _round_goes_on(self, result) -> None:
        summary = self.rounds.add(result)
        if summary is None:
            return
        self.line.say(describe(summary))
        if summary["best"]:
            self.export(self.folder / "best.safetensors", self._weights, summary)
        if self.board:
            self.board.round(summary)
        draw_curves(self.folder / "curves.png", self.episodes, self.rounds)

    # -- keeping -----------------------------------------------------------------------------------------
    def save(self) -> None:
        self.learner.save({"elapsed": self.extra.get("elapsed", 0.0) + time.monotonic() - self.began})
        self.export(self.folder / "actor.safetensors", self.learner.td3.actor_weights(), None)
        self._saved = time.monotonic()

    def export(self, path, weights, result) -> None:
        """The policy as policy/actor.py reads it, with what trained it; but nothing of this machine's folders."""
        options = {k: v for k, v in asdict(self.config).items() if k not in ("out", "resume", "ray_address")}
        metadata = {
            "training": {
                "steps": self.steps,
                "updates": self.learner.td3.updates,
                "transitions": self.learner.transitions,
                "options": options,
            },
            "result": result,
            "default": self.rounds.default if result else None,
        }
        if self.config.env == OURS:
            from applr_ros1.policy import actor

            metadata["period_s"] = self.config.period
            actor.save(path, weights, metadata)
        else:
            write_bytes(path, safetensors.numpy.save(weights, {k: json.dumps(v) for k, v in metadata.items()}))

    # -- saying --------------------------------------------------------------------------------------------
    def _say(self) -> None:
        if not self.line.due():
            return
        learner, now = self.learner, time.monotonic()
        counts = {"transitions": learner.transitions, "updates": learner.td3.updates}
        rates = self.line.rates(now, counts)
        goal, done = (self.config.updates, "updates") if self.offline else (self.config.steps, "transitions")
        left = (goal - counts[done]) / rates[done] if rates[done] > 0 else float("inf")
        losses = learner.td3.report()
        values = {
            "return": self.episodes.recent("return"),
            "length": self.episodes.recent("length"),
            "success": self.episodes.recent("success"),
            "collided": self.episodes.recent("collided"),
            "sigma": self.config.noise(learner.transitions),
            "transitions_per_second": rates["transitions"],
            "updates_per_second": rates["updates"],
            "staleness_mean": learner.staleness.mean,
            "staleness_max": learner.staleness.most,
            "actors": self.pool.alive,
            "replaced": self.pool.replaced,
            "refused": sum(learner.refused.values()),
            **losses,
        }
        self.line.show(
            "{:,} of {:,} {}  {:.1f} transitions/s  {:.1f} updates/s  sigma {:.2f}  return {:.2f}  length {:.1f}  "
            "success {:.2f}  contact {:.2f}  Q {:.2f}  policy age {:.0f} (max {})  actors {}{}{}  {} left".format(
                counts[done],
                goal,
                done,
                rates["transitions"],
                rates["updates"],
                values["sigma"],
                values["return"],
                values["length"],
                values["success"],
                values["collided"],
                losses.get("actor_q", float("nan")),
                learner.staleness.mean,
                learner.staleness.most,
                self.pool.alive,
                "  replaced %d" % self.pool.replaced if self.pool.replaced else "",
                "  refused %d" % values["refused"] if values["refused"] else "",
                clock(left),
            )
        )
        if self.board:
            self.board.scalars("training", values, self.steps)

    def _say_the_end(self) -> None:
        best = self.rounds.best
        print(
            "%s after %s transitions and %s updates, %s; %s"
            % (
                "Stopped by %s and saved" % self.stopping if self.stopping else "Done",
                format(self.learner.transitions, ","),
                format(self.learner.td3.updates, ","),
                clock(time.monotonic() - self.began),
                self.folder,
            )
        )
        if best:
            print("best actor: %s" % describe(best))
        for reason, count in sorted(self.learner.refused.items()):
            print("refused %d trajectories: %s" % (count, reason))

    def _signal(self, number, frame) -> None:
        if self.stopping:
            raise KeyboardInterrupt
        self.stopping = signal.Signals(number).name


def prepare(config: TrainConfig):
    """(settings of the workers, worlds to train in, number of held-out worlds, layout). Raises one-line errors."""
    if config.env != OURS:
        from training.gorila.worker import Worker

        settings = {"env": config.env, "train": {}, "evaluate": {}}
        try:
            layout = layout_of(Worker(settings).environment("train"))
        except (ImportError, AttributeError) as error:
            raise ConfigError("--env %s cannot be had: %s" % (config.env, error)) from None
        return settings, None, [] if config.eval_worlds == "none" else [0], layout
    import sim_bridge
    from applr_ros1.policy import observation
    from applr_ros1.policy.parameter_space import SPACE
    from training.experience.trajectory import Layout
    from training.mdp.env import ApplrEnv, load_worlds

    train = load_worlds(config.worlds)
    test = [] if config.eval_worlds == "none" else load_worlds(config.eval_worlds)
    sim_bridge.Randomisation(**config.randomisation())
    shared = {"reward": config.reward(), "period": config.period}
    settings = {
        "env": config.env,
        "train": dict(
            shared,
            worlds=config.worlds,
            simulator=config.simulator,
            weights=config.weights,
            planner=config.planner,
            planner_frequency=config.planner_frequency,
            randomisation=config.randomisation(),
        ),
        "evaluate": dict(shared, worlds=config.eval_worlds, **config.evaluation()),
    }
    if config.actors > 1:  # compile the planner's kernels once, for all: the actors find them on disk
        env = ApplrEnv(**dict(settings["train"], worlds=train[:1], limit=1))
        env.reset(seed=0)
        env.step(env.action_space.low)
        env.close()
    return (
        settings,
        train,
        list(range(len(test))),
        Layout(ApplrEnv.scan_beams, observation.SIZE - ApplrEnv.scan_beams, len(SPACE)),
    )


def set_threads(config: TrainConfig) -> None:
    """The learner's threads on the CPU: as asked, else the cores that actors on this machine leave. More threads than
    free cores wait for each other and learn many times slower.
    """
    import torch

    if config.threads:
        torch.set_num_threads(config.threads)
    elif config.actors and not config.ray_address:
        torch.set_num_threads(max(1, (os.cpu_count() or 1) - config.actors))


def _with_rows(config: TrainConfig, dataset: Optional[Dataset]):
    from dataclasses import replace

    learner = config.learner()
    if dataset is not None and dataset.rows + 1000 > learner.capacity - (0 if not config.mix else config.steps):
        learner = replace(learner, capacity=learner.capacity + dataset.rows + 1000)
    return learner


def _main_thread() -> bool:
    import threading

    return threading.current_thread() is threading.main_thread()


def main(arguments: Optional[List[str]] = None) -> int:
    """The command. 0: done; 1: a run could not go on; 2: options that cannot be; 130: stopped and saved."""
    return run_main(lambda: Training(parse(arguments)).run(), "train.py")


if __name__ == "__main__":
    sys.exit(main())
