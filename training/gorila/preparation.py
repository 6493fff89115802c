"""What a run needs before it begins: who does its workers' tasks, its worlds, and how observations are stored."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import torch

import sim_bridge
from applr_ros1.common.errors import reason
from applr_ros1.policy.observation import sizes_of
from applr_ros1.robots import load
from training.evaluation.trials import TRIAL_RUNNER, evenly_spaced, world_list
from training.experience.dataset import Dataset
from training.experience.trajectory import Layout
from training.gorila.collector import layout_of
from training.gorila.config import ConfigError, TrainConfig, dashed
from training.gorila.learner import LearnerConfig
from training.mdp.env import ApplrEnv, load_worlds
from training.mdp.episode import CONTROL_PERIOD
from training.mdp.rollout import NAVIGATION, make_environment
from training.workers.tasks import RunnerSpec, WorkerSettings
from worlds import World


@dataclass(frozen=True)
class Preparation:
    """What prepare() found."""

    settings: WorkerSettings
    train_worlds: Optional[Sequence[World]]  # None where the environment has none of ours
    held_out: List[Tuple[str, str]]  # (name, specification) of the periodic evaluation's worlds
    layout: Layout


def prepare(config: TrainConfig) -> Preparation:
    """Checks worlds and environment before anything is begun. Raises errors of one line."""
    evaluates = config.eval_worlds != "none"
    if config.env != NAVIGATION:
        environment = {"env": config.env, "options": {}}
        settings = WorkerSettings(
            RunnerSpec("training.gorila.collector:Collector", environment),
            RunnerSpec("training.gorila.collector:EnvironmentTrials", environment),
        )
        try:
            layout = layout_of(make_environment(config.env, {}))
        except Exception as error:  # whatever a person's environment raises
            raise ConfigError(
                "--env %s cannot be had: %s: %s" % (config.env, type(error).__name__, reason(error))
            ) from None
        return Preparation(settings, None, [("environment", "")] if evaluates else [], layout)
    robot, worlds = load(config.robot), load_worlds(config.worlds)
    held_out = [world[:2] for world in world_list(config.eval_worlds, "paper", robot)] if evaluates else []
    sim_bridge.Randomisation(**config.randomisation())
    options = {
        "robot": config.robot,
        "worlds": config.worlds,
        "simulator": config.simulator,
        "weights": config.weights,
        "planner": config.planner,
        "planner_frequency": config.planner_frequency or None,
        "randomisation": config.randomisation(),
        "reward": config.reward(),
        "period": config.period,
        "end_on_contact": config.end_on_contact,
        "monitor": config.monitor,
    }
    judge = config.evaluation()["simulator"]
    trials = {
        "robot": config.robot,
        "simulator": judge,
        "reward": config.reward(),
        "period": config.period,
        "monitor": config.monitor,
        "learnt_with": config.weights,
    }
    env = ApplrEnv(**dict(options, worlds=worlds[:1], limit=1))
    if config.actors > 1:  # compile the planner's kernels once, for all: the actors find them on disk
        env.reset(seed=0)
        env.step(-np.ones(len(env.space)))
    env.close()
    if evaluates and judge != config.simulator:
        sim_bridge.make(judge, robot=robot).close()
    return Preparation(
        WorkerSettings(
            RunnerSpec("training.gorila.collector:Collector", {"env": config.env, "options": options}),
            RunnerSpec(TRIAL_RUNNER, trials),
        ),
        worlds,
        evenly_spaced(held_out, config.eval_count),
        Layout(*sizes_of(robot)),
    )


def set_threads(config: TrainConfig) -> None:
    """The learner's threads on the CPU: as asked, else the cores that actors on this machine leave.

    More threads than free cores wait for each other and learn many times slower.
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    elif config.actors and not config.ray_address:
        torch.set_num_threads(max(1, len(os.sched_getaffinity(0)) - config.actors))


def dataset_of(config: TrainConfig, layout: Layout) -> Optional[Dataset]:
    """The dataset --dataset, read and checked; None without one.

    Raises:
        ConfigError: it was driven with another period, kind of weights, robot or reward than the options say.
        DatasetError: it is none, or damaged.
    """
    if not config.dataset:
        return None
    dataset = Dataset(config.dataset, layout)
    options: Dict[str, Any] = {"period": config.period}
    if config.env == NAVIGATION:
        options.update(weights=config.weights, robot=load(config.robot).name)
    for name, value in options.items():
        driven = dataset.source.get(name, value)
        near = isinstance(driven, float) and isinstance(value, float) and abs(driven - value) < CONTROL_PERIOD / 2
        if driven != value and not near:
            raise ConfigError(
                "--%s is %s, but the dataset %s was driven with %.40s: give --%s %.40s"
                % (name, value, config.dataset, driven, name, driven)
            )
    stated = dataset.source.get("reward")
    if config.env == NAVIGATION and isinstance(stated, dict):
        _check_reward(config, stated)
    return dataset.check()


def _check_reward(config: TrainConfig, stated: Dict[str, Any]) -> None:
    """Raises ConfigError where the rewards of the dataset were computed with other coefficients than the options."""
    for name, value in config.reward().items():
        theirs = stated.get(name, value)
        if theirs != value:
            option = dashed(name)
            give = (
                ("--" if theirs else "--no-") + option if isinstance(value, bool) else "--%s %.40s" % (option, theirs)
            )
            raise ConfigError(
                "--%s is %s, but the rewards of the dataset %s were computed with %.40s: give %s, or make the dataset "
                "anew" % (option, value, config.dataset, theirs, give)
            )


def learner_config(config: TrainConfig, dataset: Optional[Dataset]) -> LearnerConfig:
    """The learner's options, with room for the dataset in the replay."""
    learner = config.learner()
    if dataset is not None and dataset.rows + 1000 > learner.capacity - (0 if not config.mix else config.steps):
        learner = replace(learner, capacity=learner.capacity + dataset.rows + 1000)
    return learner
