"""The trials of an evaluation as arrays: by method and world, in the paper's two sets, in thirds of difficulty.

All tables and figures of the report are made from these.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_json
from applr_ros1.policy.parameter_space import Space
from training.evaluation.score import FAILURE_SECONDS
from training.evaluation.store import MEASURES_FILE, SETTINGS, TRIALS, flag, read_rows, read_trace
from training.evaluation.trials import COLUMNS, KEY, MEASURES
from worlds import barn

SETS = ("Training", "Test", "Physical course", "Other")
THIRDS = ("Easy", "Medium", "Difficult")
BASELINE = "dwa"
NUMBERS = {  # fields of a Cell by the columns of the files
    "time": "time_s",
    "decisions": "decisions",
    "path_length": "path_length_m",
    "route": "route_m",
    "clearance": "min_clearance_m",
    "jerk": "mean_jerk",
    "turn": "mean_turn",
    "switching": "switching",
}
# what joined evaluations must have in common
SAME = ("simulator", "protocol", "planner", "monitor", "ground", "robot", "seed")


@dataclass(frozen=True)
class Cell:
    """The trials of one method in one world, in their order: arrays (n,)."""

    success: np.ndarray
    collided: np.ndarray
    timeout: np.ndarray
    time: np.ndarray  # [s]; the limit where it timed out, the time until then where a contact or a flip ended it
    decisions: np.ndarray
    path_length: np.ndarray  # [m]
    reason: List[str]
    route: np.ndarray  # length of the reference route [m]
    clearance: np.ndarray  # smallest laser range [m]
    jerk: np.ndarray  # mean |jerk| [m/s^3]
    turn: np.ndarray  # mean |yaw acceleration| [rad/s^2]
    switching: np.ndarray  # mean change of the parameters per decision, of their range in [-1, 1]

    @property
    def times(self) -> np.ndarray:
        """Times of the successful trials [s]."""
        return self.time[self.success]

    @property
    def counted(self) -> np.ndarray:
        """Times of all trials (n,) [s], a failed one counting as the limit however it ended."""
        return np.where(self.success, self.time, FAILURE_SECONDS)


class Results:
    """cells[method][world], the evaluation's settings, and how worlds are grouped.

    Args:
        folder: the folder of an evaluation.
        joined: folders of evaluations of the same methods in other worlds, or of other methods in the same worlds,
            whose trials count as if they were here.

    Raises:
        ApplrError: there are no trials, a folder is given twice, or the joined evaluations do not fit together.
        StorageError: a folder cannot be read.
    """

    def __init__(self, folder: os.PathLike | str, joined: Sequence[os.PathLike | str] = ()):
        self.folder, self.joined = Path(folder), [Path(other) for other in joined]
        self._folder_of: Dict[Tuple[str, str], Path] = {}  # of each world and method
        rows, resolved, key = [], set(), itemgetter(*KEY)
        for place in (self.folder, *self.joined):
            if place.resolve() in resolved:
                raise ApplrError(f"{place}: given twice, so that its trials would count twice; join it once")
            resolved.add(place.resolve())
            found = read_rows(place / TRIALS, COLUMNS)
            for driven in dict.fromkeys((row["world"], row["method"]) for row in found):
                if self._folder_of.setdefault(driven, place) != place:
                    raise ApplrError(
                        f"{self._folder_of[driven]} and {place} both have {driven[0]} of {driven[1]}; join other "
                        "worlds or other methods"
                    )
            measures = {key(row): row for row in read_rows(place / MEASURES_FILE, MEASURES)}
            rows += [{**row, **measures[key(row)]} for row in found]
        if not rows:
            raise ApplrError(f"{self.folder} holds no trials; give a folder that evaluate.py wrote")
        self.settings = dict(read_json(self.folder / SETTINGS))
        self._digests = {tuple(self.settings["worlds"]): self.settings["worlds_sha256"]}
        for place in self.joined:
            self._join(place)
        self.planner: str = self.settings["planner"]
        self.robot: Dict[str, Any] = self.settings["robot"]  # trials.described gives it
        self.space = Space.stated(self.robot["space"], self.robot["name"])
        if self.settings["monitor"]:
            self.planner += ", with the collision monitor"
        self.count = len(rows)
        self.methods = list(dict.fromkeys(row["method"] for row in rows))
        self.worlds = list(dict.fromkeys(row["world"] for row in rows))
        self._moving = set(self.settings["worlds_with_movers"])
        self.baseline = BASELINE if BASELINE in self.methods else self.methods[0]
        self.rivals = [m for m in self.methods if m != self.baseline]
        try:
            self.cells = self._cells(rows)
        except ValueError as error:
            raise ApplrError(f"{self.folder / TRIALS}: {error}; evaluate anew into another folder") from None

    def _join(self, place: Path) -> None:
        """Takes over another evaluation's worlds and methods. Raises ApplrError where something else differs, too."""
        here, there = self.settings, read_json(place / SETTINGS)
        other = [name for name in SAME if here[name] != there[name]]
        names, digest = tuple(there["worlds"]), there["worlds_sha256"]
        if self._digests.setdefault(names, digest) != digest:
            other.append("set of worlds of the same names")
        methods, more = here["methods"], there["methods"]
        other += [name for name in methods if name in more and methods[name] != more[name]]
        if other:
            raise ApplrError(f"{place}: driven with another {other[0]} than {self.folder}; it cannot be joined")
        here["methods"] = {**methods, **more}
        known = set(here["worlds"])
        for name, spec in zip(there["worlds"], there["world_specs"]):
            if name not in known:
                here["worlds"].append(name)
                here["world_specs"].append(spec)
        for name in ("worlds_with_movers", "provenance"):
            here[name] = [*here.get(name, []), *there.get(name, [])]
        here["wall_s"] = here.get("wall_s", 0.0) + there.get("wall_s", 0.0)

    def trace(self, world: str, method: str, trial: int) -> Optional[Dict[str, Any]]:
        """What was recorded of a trial (store.read_trace), None where nothing was."""
        place = self._folder_of.get((world, method))
        return read_trace(place, world, method, trial) if place else None

    @staticmethod
    def _cells(rows: List[Dict[str, str]]) -> Dict[str, Dict[str, Cell]]:
        found: Dict[str, Dict[str, List[Dict[str, str]]]] = {}
        for row in rows:
            found.setdefault(row["method"], {}).setdefault(row["world"], []).append(row)
        return {method: {world: _cell(trials) for world, trials in worlds.items()} for method, worlds in found.items()}

    def of_set(self, name: str) -> List[str]:
        """Worlds of one of SETS, in their order."""
        return [w for w in self.worlds if self._set_of(w) == name]

    def _set_of(self, world: str) -> str:
        return "Other" if world in self._moving else set_of(world)  # DynaBARN's numbers are BARN's too

    def groups(self, methods: Optional[Sequence[str]] = None) -> Iterator[Tuple[str, List[str], str]]:
        """(name of the set, its worlds, method) of each of SETS that has worlds, and each of the methods, or all."""
        for name in SETS:
            worlds = self.of_set(name)
            for method in (self.methods if methods is None else methods) if worlds else []:
                yield name, worlds, method

    def both(self, method: str, worlds: List[str], other: str = "") -> List[str]:
        """Those of `worlds` that both `method` and the other method, or the baseline, have driven."""
        return [w for w in worlds if w in self.cells[method] and w in self.cells[other or self.baseline]]

    def by_difficulty(self, worlds: List[str]) -> List[str]:
        """Worlds by the baseline's mean time over all trials, a failed one counting as the limit; fastest first."""
        cells = self.cells[self.baseline]
        return sorted((w for w in worlds if w in cells), key=lambda w: (cells[w].counted.mean(), w))

    def thirds(self) -> Dict[str, List[str]]:
        """All training and test worlds in thirds of difficulty, as the paper has them: 100 each of 300."""
        ordered = self.by_difficulty([w for w in self.worlds if self._set_of(w) in SETS[:2]])
        return dict(zip(THIRDS, (list(part) for part in np.array_split(np.array(ordered, dtype=object), 3))))

    def pooled(self, method: str, worlds: List[str], field: str) -> np.ndarray:
        """A field of all trials of `method` in `worlds`."""
        parts = [getattr(self.cells[method][w], field) for w in worlds if w in self.cells[method]]
        return np.concatenate(parts) if parts else np.zeros(0)


def _cell(trials: List[Dict[str, str]]) -> Cell:
    flags = {name: np.array([flag(trial[name]) for trial in trials]) for name in ("success", "collided", "timeout")}
    numbers = {name: np.array([float(trial[column]) for trial in trials]) for name, column in NUMBERS.items()}
    return Cell(reason=[trial["reason"] for trial in trials], **flags, **numbers)


def set_of(world: str) -> str:
    """Training or Test by BARN's split, for the built-in worlds and for BARN's own files, going by the name."""
    match = re.match(r"^(?:generated:|world_)(\d+)$", world)
    if match and int(match.group(1)) < 300:
        return "Test" if int(match.group(1)) in barn.TEST else "Training"
    return "Physical course" if world == "physical_course" else "Other"
