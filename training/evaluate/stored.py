"""Trials of a stored evaluation, grouped as in the paper: by group of worlds and by difficulty."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import pandas as pd

import worlds as worlds_package
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json
from applr_ros1.policy.parameter_space import Space
from training.env.settings import under
from training.evaluate.compare import Comparison, compare
from training.evaluate.score import seconds
from training.evaluate.table import SETTINGS, TRIALS, read_trials
from training.evaluate.trial import BASELINE
from worlds import World, barn

SETS = ("Training", "Test", "Physical course", "Other")
THIRDS = ("Easy", "Medium", "Difficult")


class Results:
    """Trials of an evaluation, its settings, and its groups of worlds.

    Args:
        folder: Folder of an evaluation.

    Attributes:
        trials: A row per trial with the columns of trials.csv, "set" (group of the world), and "score" [s] (seconds()
            in score.py).

    Raises:
        ApplrError: There are no trials, or the folder cannot be read.
    """

    def __init__(self, folder: os.PathLike[str] | str):
        self.folder = Path(folder)
        trials = read_trials(self.folder / TRIALS)
        if trials.empty:
            raise ApplrError(f"{self.folder} holds no trials: give a folder that evaluate.py wrote")
        self.settings = dict(read_json(self.folder / SETTINGS))
        self._specs = dict(zip(self.settings["worlds"], self.settings["world_specs"]))
        self.robot: Dict[str, Any] = self.settings[
            "robot"
        ]  # name, body, world_scale and space (evaluation.settings)
        self.space = Space.from_metadata(self.robot["space"], self.robot["name"])
        moving = self.settings["worlds_with_movers"]
        set_of_world = {
            name: "Other" if name in moving else set_of(name) for name in trials.world.unique()
        }
        self.trials = trials.assign(set=trials.world.map(set_of_world), score=seconds(trials))
        self.methods: List[str] = trials.method.unique().tolist()
        self.worlds: List[str] = trials.world.unique().tolist()
        self.baseline = BASELINE if BASELINE in self.methods else self.methods[0]
        self.rivals = [m for m in self.methods if m != self.baseline]

    def of(self, method: str, worlds: Sequence[str]) -> pd.DataFrame:
        """Return the trials of a method in some worlds."""
        return self.trials[(self.trials.method == method) & self.trials.world.isin(worlds)]

    def of_set(self, name: str) -> List[str]:
        """Return the worlds of one of SETS, in the order of the trials."""
        return list(self.trials.world[self.trials.set == name].unique())

    def groups(
        self, methods: Optional[Sequence[str]] = None
    ) -> Iterator[Tuple[str, str, pd.DataFrame]]:
        """Yield (name of the group, method, trials) for each of SETS that has worlds and each method (default: all)."""
        for name in SETS:
            worlds = self.of_set(name)
            for method in (self.methods if methods is None else methods) if worlds else []:
                yield name, method, self.of(method, worlds)

    @property
    def scores(self) -> pd.DataFrame:
        """Mean scores [s]: a row for each world, a column for each method."""
        return self.trials.groupby(["world", "method"], sort=False).score.mean().unstack()

    def compare(self, method: str, other: str, worlds: Sequence[str]) -> Comparison:
        """Compare two methods over those of `worlds` in which both have trials."""
        ours, theirs = (self.scores[one].reindex(worlds) for one in (method, other))
        both = ours.notna() & theirs.notna()
        return compare(ours[both], theirs[both])

    def by_difficulty(self, worlds: Sequence[str]) -> List[str]:
        """Return the worlds sorted by the baseline's score, fastest first."""
        scores = self.scores[self.baseline].reindex(worlds).dropna()
        return sorted(scores.index, key=lambda world: (scores[world], world))

    def thirds(self) -> Dict[str, List[str]]:
        """Return all training and test worlds in thirds of difficulty, as in the paper: 100 each of 300."""
        ordered = self.by_difficulty(
            self.trials.world[self.trials.set.isin(SETS[:2])].unique().tolist()
        )
        return dict(
            zip(THIRDS, (list(part) for part in np.array_split(np.array(ordered, dtype=object), 3)))
        )

    def load(self, name: str) -> World:
        """Return a world of the evaluation, at the scale of its robot."""
        radius = self.robot.get("radius", 0.0)  # Older evaluations have neither a radius nor maps.
        world = under(self.settings["protocol"], worlds_package.load(self._specs[name], radius))
        return worlds_package.scaled(world, self.robot["world_scale"])


def set_of(world: str) -> str:
    """Return the group of a world by its name. Generated worlds and BARN's own files follow BARN's split."""
    match = re.match(r"^(?:generated:|world_)(\d+)$", world)
    if match and int(match.group(1)) < 300:
        return "Test" if int(match.group(1)) in barn.TEST else "Training"
    return "Physical course" if world == "physical_course" else "Other"
