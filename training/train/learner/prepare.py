"""Preparation of a run: tasks of its workers, worlds, and layout of observations."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from typing import Callable, List, Optional, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots.geometry import radius
from training.env.env import ApplrEnv
from training.env.reward import Reward
from training.env.trajectory import Trajectory, TransitionLayout
from training.evaluate.runner import TrialWorld, run, world_list
from training.evaluate.trial import Result, Trial
from training.train.learner.config import TrainConfig
from training.train.replay.dataset import FEWEST_TRANSITIONS, Dataset
from training.workers.collect import Collect, collect
from worlds.loading import Worlds


@dataclass(frozen=True)
class Preparation:
    """Tasks, worlds and layout of a run, made by prepare()."""

    # Drive a training episode, or a trial, with policy weights in a worker
    collect: Callable[[Collect, bytes], Trajectory]
    drive: Callable[[Trial, bytes], Tuple[Result, bytes]]
    held_out: List[TrialWorld]  # worlds for evaluation
    layout: TransitionLayout


def prepare(config: TrainConfig) -> Preparation:
    """Check worlds and environment before a run starts, and return its preparation.

    Raises:
        ApplrError: There are no such worlds, or an option of the environment is invalid.
    """
    worlds = Worlds(config.worlds, radius(config.robot))
    judged = config.judged
    held_out: List[TrialWorld] = []
    if config.eval_worlds != "none":
        held_out = world_list(config.eval_worlds, judged["protocol"], config.robot)

    # One environment checks the options and gives the layout.
    options = config.environment()
    env = ApplrEnv(**{**options, "worlds": worlds[:1]})
    if config.actors > 1:
        # Compile the planner's kernels once, so that the actors find them on disk.
        env.reset(seed=0)
        env.step(-np.ones(env.layout.action, np.float32))
    env.close()
    settings = env.settings.model_copy(update={**judged, "randomisation": {}})
    return Preparation(
        collect=partial(collect, ApplrEnv, json.dumps(options)),
        drive=partial(run, settings),
        held_out=held_out,
        layout=env.layout,
    )


def dataset_of(config: TrainConfig) -> Optional[Dataset]:
    """Return the checked dataset of --dataset, or None if the option is not given.

    Raises:
        ApplrError: The dataset's period, robot, observation or reward differ from those of the
            options, or it is too small.
    """
    if not config.dataset:
        return None
    dataset = Dataset(config.dataset)
    wanted = {
        "decision_period": config.decision_period,
        "observation": config.observation,
        "critics_know_more": config.critics_know_more,
        "robot": config.robot.name,
        **Reward.of(config).model_dump(),
    }
    for name, value in wanted.items():
        recorded = dataset.about.get(name, value)
        if recorded != value:
            raise ApplrError(
                f"{name} is {value}, but the dataset {config.dataset} was driven with {recorded}: "
                "give the same, or make a new dataset"
            )
    if dataset.transitions < FEWEST_TRANSITIONS:
        raise ApplrError(
            f"the dataset {config.dataset} has {dataset.transitions} transitions, from which no "
            f"policy learns: record at least {FEWEST_TRANSITIONS}, better an hour of drives"
        )
    return dataset
