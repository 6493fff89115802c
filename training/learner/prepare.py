"""Preparation of a run: the tasks of its workers, its worlds, and how observations are stored."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Dict, List, Optional, Tuple

import numpy as np

import sim_bridge
from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import load
from training.common.options import dashed
from training.env.env import ApplrEnv, load_worlds
from training.env.reward import Reward
from training.env.settings import TrialSettings
from training.evaluation.runner import run, world_list
from training.evaluation.trial import Result, Trial
from training.learner.config import TrainConfig
from training.replay.dataset import Dataset
from training.replay.trajectory import Trajectory, TransitionLayout
from training.workers.collect import NAVIGATION, Collect, collect, layout_of


@dataclass(frozen=True)
class Preparation:
    """Findings of prepare()."""

    collect: Callable[[Collect, bytes], Trajectory]  # drives a training episode with a policy's weights in a worker
    drive: Callable[[Trial, bytes], Tuple[Result, bytes]]  # the same of a trial
    worlds: Optional[int]  # how many there are to train in; None: the environment chooses
    held_out: List[Tuple[str, str]]  # (name, specification) of the periodic evaluation's worlds
    layout: TransitionLayout


def prepare(config: TrainConfig) -> Preparation:
    """Checks worlds and environment before anything is begun. Raises ApplrError with one line."""
    evaluates = config.eval_worlds != "none"
    robot, worlds = load(config.robot), load_worlds(config.worlds)
    held_out = [world[:2] for world in world_list(config.eval_worlds, config.eval_protocol, robot)] if evaluates else []
    sim_bridge.Randomisation(**config.randomisation())
    shared = ("robot", "simulator", "monitor", "movers", "observation")
    common: Dict[str, Any] = {name: getattr(config, name) for name in shared}
    common.update(reward=config.reward(), period=config.decision_period, base=config.start.base)
    own = ("worlds", "planner", "protocol", "end_on_collision", "end_on_stall", "critics_know_more")
    options = {**common, "randomisation": config.randomisation(), **{name: getattr(config, name) for name in own}}
    env = ApplrEnv(**dict(options, worlds=worlds[:1], limit=1))
    if config.actors > 1:  # compile the planner's kernels once, for all: the actors find them on disk
        env.reset(seed=0)
        env.step(-np.ones(layout_of(env).action, np.float32))
    env.close()
    return Preparation(
        partial(collect, NAVIGATION, json.dumps(options)),
        partial(run, TrialSettings(**common, protocol=config.eval_protocol)),
        len(worlds),
        held_out,
        layout_of(env),
    )


def driven_with(config: TrainConfig) -> Dict[str, Any]:
    """Return the settings of a run's experience, as its dataset must have them, too."""
    shared = {name: getattr(config, name) for name in ("decision_period", "observation", "critics_know_more")}
    return {**shared, "robot": load(config.robot).name, **Reward(**config.reward()).model_dump()}


def dataset_of(config: TrainConfig, layout: TransitionLayout) -> Optional[Dataset]:
    """The dataset --dataset, read and checked; None without one.

    Raises:
        ApplrError: with one line; it is none, or was driven with another period, robot or reward than the options
            say.
    """
    if not config.dataset:
        return None
    dataset = Dataset(config.dataset)
    for name, value in driven_with(config).items():
        if (theirs := dataset.about.get(name, value)) != value:
            given = dashed(name if theirs else "no_" + name) if isinstance(value, bool) else f"{dashed(name)} {theirs}"
            raise ApplrError(
                f"{name} is {value}, but the dataset {config.dataset} was driven with {theirs}: give {given}, or make "
                "the dataset anew"
            )
    if dataset.layout != layout:
        raise ApplrError(f"{config.dataset}: its layout is {dataset.layout}, this training has {layout}")
    return dataset
