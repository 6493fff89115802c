"""Trials of a stored evaluation, grouped as in the paper: by group of worlds and by difficulty."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Sequence

import numpy as np
import pandas as pd

import worlds as worlds_package
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json, reading
from applr_ros1.policy.parameter_space import Space
from training.attempts.verdict import Comparison, compare
from training.env.settings import under
from training.evaluate.score import mean_scores, seconds
from training.evaluate.table import SETTINGS, TRIALS, read_trials
from training.evaluate.trial import BASELINE
from worlds import World, barn

# Groups of worlds; those of BARN first
TRAINING = "Training"
TEST = "Test"
PHYSICAL_COURSE = "Physical course"
OTHER = "Other"
SETS = (TRAINING, TEST, PHYSICAL_COURSE, OTHER)
THIRDS = ("Easy", "Medium", "Difficult")


class Group(NamedTuple):
    """Trials of a method in a group of worlds."""

    worlds: str
    method: str
    trials: pd.DataFrame


class Results:
    """Trials of an evaluation, its settings, and its groups of worlds.

    Args:
        folder: Folder of an evaluation.

    Attributes:
        trials: A row per trial with the columns of trials.csv, "set" (group of the world), and
            "score" [s] (seconds() in score.py).
        settings: Content of evaluation.json.
        robot: Its part about the robot: name, outline, world_scale, space (evaluation.settings).
        methods: Names of the methods.
        worlds: Names of the worlds.
        baseline: Method that the others are compared with.
        rivals: The other methods.

    Raises:
        ApplrError: There are no trials, or the folder cannot be read.
    """

    def __init__(self, folder: os.PathLike[str] | str):
        self.folder = Path(folder)
        trials = read_trials(self.folder / TRIALS)
        if trials.empty:
            raise ApplrError(
                f"{self.folder} holds no trials: give a folder that ./applr evaluate wrote"
            )
        settings_file = self.folder / SETTINGS
        with reading(settings_file):
            self.settings = dict(read_json(settings_file))
            self.robot: Dict[str, Any] = self.settings["robot"]
            self.space = Space.from_metadata(self.robot["space"], self.robot["name"])
            self._specifications = dict(zip(self.settings["worlds"], self.settings["world_specs"]))

        self.methods: List[str] = trials.method.unique().tolist()
        self.worlds: List[str] = trials.world.unique().tolist()
        self.baseline = BASELINE if BASELINE in self.methods else self.methods[0]
        self.rivals = self.methods.copy()
        self.rivals.remove(self.baseline)

        # With moving obstacles, a world of BARN is not comparable with the paper's.
        has_movers = trials.world.isin(self.settings["worlds_with_movers"])
        groups = trials.world.map(set_of).mask(has_movers, OTHER)
        self.trials = trials.assign(set=groups, score=seconds(trials))

    @property
    def outline(self) -> np.ndarray:
        """Corners (n, 2) of the robot's outline [m]."""
        return np.array(self.robot["outline"])

    def of(self, method: str, worlds: Sequence[str]) -> pd.DataFrame:
        """Return the trials of a method in some worlds."""
        return self.trials[(self.trials.method == method) & self.trials.world.isin(worlds)]

    def of_set(self, name: str) -> List[str]:
        """Return the worlds of one of SETS, in the order of the trials."""
        return list(self.trials.world[self.trials.set == name].unique())

    def groups(self, methods: Sequence[str]) -> Iterator[Group]:
        """Yield the trials of some methods in each of SETS that has worlds, method by method."""
        for name in SETS:
            worlds = self.of_set(name)
            if worlds:
                for method in methods:
                    yield Group(name, method, self.of(method, worlds))

    def compare(self, method: str, other: str, worlds: Sequence[str]) -> Comparison:
        """Compare two methods over those of `worlds` in which both have trials."""
        scores = mean_scores(self.trials).reindex(worlds)
        in_both = scores[method].notna() & scores[other].notna()
        return compare(scores[method][in_both], scores[other][in_both])

    def by_difficulty(self, worlds: Sequence[str]) -> List[str]:
        """Return the worlds sorted by the baseline's score, fastest first."""
        scores = mean_scores(self.trials)[self.baseline].reindex(worlds).dropna()
        # By name where scores are equal, so that the order is always the same
        return sorted(scores.index, key=lambda world: (scores[world], world))

    def thirds(self) -> Dict[str, List[str]]:
        """Return the worlds of each of THIRDS, as in the paper: 100 each of its 300 worlds.

        The thirds are of all training and test worlds.
        """
        ordered = self.by_difficulty([*self.of_set(TRAINING), *self.of_set(TEST)])
        thirds = np.array_split(np.array(ordered, dtype=object), len(THIRDS))
        return dict(zip(THIRDS, map(list, thirds)))

    def load(self, name: str) -> World:
        """Return a world of the evaluation, at the scale of its robot."""
        world = worlds_package.load(self._specifications[name], self.robot["radius"])
        return worlds_package.scaled(
            under(self.settings["protocol"], world), self.robot["world_scale"]
        )


def set_of(world: str) -> str:
    """Return the group of a world by its name.

    Generated worlds and BARN's own files follow BARN's split.
    """
    if world == "physical_course":
        return PHYSICAL_COURSE
    match = re.match(r"^(?:generated:|world_)(\d+)$", world)
    if match is None:
        return OTHER
    number = int(match.group(1))
    if number >= 300:  # BARN has 300 worlds.
        return OTHER
    return TEST if number in barn.TEST else TRAINING
