"""An evaluation's folder, which a kill at any moment costs only the trials that were under way.

trials.csv has a row for each trial, appended when it was driven and at the end brought into the plan's order.
evaluation.json says what was asked, traces/ holds the driven paths. evaluate.py writes, the report reads; searches keep
their trials in such a table too.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
from dataclasses import asdict, astuple, fields, replace
from pathlib import Path
from typing import Any, Dict, Optional, Sequence, Tuple

import numpy as np
import pandas as pd

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, read_bytes, read_json, sha256, write_bytes, write_json
from training.common.folders import Lock, make_folder
from training.evaluation.plan import TRACED, Trial, TrialResult

TRIALS, SETTINGS, TRACES = "trials.csv", "evaluation.json", "traces"
COLUMNS: Dict[str, Any] = {"world": "str", "method": "str", "trial": "int", "seed": "int"}  # with their types
COLUMNS.update({field.name: field.type for field in fields(TrialResult)})
NAN = {name: ["nan"] for name, kind in COLUMNS.items() if kind == "float"}
Key = Tuple[str, str, int, int]


def read_trials(path: os.PathLike | str) -> pd.DataFrame:
    """A table of trials with the types of COLUMNS; empty where there is no file, or nothing in it.

    What follows the last end of a line is left out: the process was killed while it wrote that row.

    Raises:
        StorageError: when the file is of another kind, or damaged.
    """
    data = read_bytes(path) if Path(path).exists() else b""
    whole = data[: data.rfind(b"\n") + 1] or (",".join(COLUMNS) + "\n").encode()
    try:
        found = pd.read_csv(io.BytesIO(whole), dtype=COLUMNS, index_col=False, keep_default_na=False, na_values=NAN)
        if "mean_clearance_m" not in found:  # a table of before that was noted
            found.insert(found.shape[1] - 1, "mean_clearance_m", np.nan)
        if list(found.columns) != list(COLUMNS) or found["total_reward"].isna().any():
            raise ValueError("other columns, or a row without some of them")
    except ValueError as error:
        raise StorageError(f"{path}: {reason(error)}; expected {','.join(COLUMNS)}; give another folder") from None
    return found.round(4)  # whatever the parser made of the last bit


class TrialTable:
    """Results of trials in a CSV file, numbers to four digits.

    Args:
        path: of the file, which is made where it is missing.
        setting: what beside the trial tells results apart, as JSON values; its digest with that of the trial is a part
            of the method's name. None: the trial's names are enough.

    Raises:
        StorageError: with one line, from every method, for a file that cannot be read or written or is none of ours.
    """

    def __init__(self, path: os.PathLike | str, setting: Optional[Sequence[Any]] = None):
        self.path, self.setting = Path(path), setting
        rows = [tuple(row) for row in read_trials(path).itertuples(index=False)]
        self._results: Dict[Key, TrialResult] = {row[:4]: TrialResult(*row[4:]) for row in rows}
        self.write()

    def find(self, trial: Trial) -> Optional[TrialResult]:
        """The result of a trial, or None."""
        return self._results.get(self._key(trial))

    def add(self, trial: Trial, result: TrialResult, trace: bytes = b"") -> TrialResult:
        """Keep a trial, but for its trace, on the disk; returns the result as it is kept."""
        values: Dict[str, Any] = {k: round(v, 4) if isinstance(v, float) else v for k, v in vars(result).items()}
        kept = TrialResult(**values)
        self._results[self._key(trial)] = kept
        try:
            with open(self.path, "ab") as file:
                file.write(_lines([(*self._key(trial), *astuple(kept))]))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise StorageError(
                f"{self.path}: cannot be written ({reason(error)}); its trials are safe, the same command continues"
            ) from None
        return kept

    def write(self, plan: Sequence[Trial] = ()) -> None:
        """Writes the file anew: the trials of a plan in its order, and then the others."""
        keys = dict.fromkeys(key for key in map(self._key, plan) if key in self._results)
        rows = [(*key, *astuple(self._results[key])) for key in {**keys, **self._results}]
        write_bytes(self.path, _lines([tuple(COLUMNS), *rows]))

    def _key(self, trial: Trial) -> Key:
        method = trial.method
        if self.setting is not None:
            method += "-" + sha256(json.dumps([self.setting, asdict(replace(trial, trace=False))]))[:16]
        return trial.world, method, trial.trial, trial.seed


class TrialStore(TrialTable):
    """The folder with its table, locked for this process.

    Args:
        out: the folder.
        settings: what must be the same when an evaluation is continued.
        plan: trials whose results are in `results`.
    """

    def __init__(self, out, settings: Dict[str, Any], plan: Sequence[Trial]):
        self.folder, self.plan = make_folder(out), plan
        self._lock = Lock(self.folder, "evaluate.py")
        try:
            self._settings = self._checked(settings)
            super().__init__(self.folder / TRIALS)
            self.results = {trial: result for trial in plan if (result := self.find(trial)) is not None}
            self._begun_with = len(self.results)
        except BaseException:
            self._lock.close()
            raise

    def _checked(self, settings: Dict[str, Any]) -> Dict[str, Any]:
        """The settings with what else is noted. StorageError where the folder is another evaluation's."""
        path = self.folder / SETTINGS
        if not path.exists():
            if (self.folder / TRIALS).exists():
                raise StorageError(f"{self.folder}: holds trials, but {SETTINGS} is missing; give another --out")
            write_json(path, settings)
            return dict(settings)
        stored = read_json(path)
        for name in settings:
            there = stored.get(name) if isinstance(stored, dict) else None
            if json.loads(json.dumps(settings[name])) != there:
                remedy = "give another --out, or the same options"
                if name == "methods":
                    remedy += "; training.report --join shows the methods of two folders together"
                was, now = _short(there), _short(settings[name])
                raise StorageError(f"{self.folder}: was begun with another {name} ({was}, now {now}); {remedy}")
        return stored

    def add(self, trial: Trial, result: TrialResult, trace: bytes = b"") -> TrialResult:
        """Keep a trial; its row comes last: what is there is whole. Returns the result as it is kept."""
        if trace:
            write_bytes(make_folder(self.folder / TRACES) / trace_name(trial.world, trial.method, trial.trial), trace)
        self.results[trial] = super().add(trial, result)
        return self.results[trial]

    def finish(self, seconds: float, provenance: Optional[Dict[str, Any]] = None, **more: Any) -> None:
        """Notes how long was worked on it, in all sessions together, and where this session's trials come from."""
        self._settings["wall_s"] = round(self._settings.get("wall_s", 0.0) + seconds, 1)
        if provenance is not None:
            driven = len(self.results) - self._begun_with
            session = dict(provenance, trials=driven, wall_s=round(seconds, 1))
            self._settings["provenance"] = [*self._settings.get("provenance", []), session]
        self._settings.update(more)
        write_json(self.folder / SETTINGS, self._settings)

    def close(self) -> None:
        """Brings the rows into the plan's order, and lets go of the folder."""
        try:
            self.write(self.plan)
        finally:
            self._lock.close()


def trace_name(world: str, method: str, trial: int) -> str:
    """File name of a trial's trace."""
    return "__".join(re.sub(r"[^\w.+-]", "-", str(part)) for part in (world, method, trial)) + ".npz"


def read_trace(folder: os.PathLike | str, world: str, method: str, trial: int) -> Optional[Dict[str, Any]]:
    """{"time", "pose", "twist", "theta", "decided"} of a trial whose trace was kept, else None.

    decided: when each row of theta was chosen [s].
    """
    path = Path(folder) / TRACES / trace_name(world, method, trial)
    try:
        with np.load(path) as arrays:
            return {name: arrays[name] for name in TRACED}
    except FileNotFoundError:
        return None


def _lines(rows: Sequence[Sequence[Any]]) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue().encode()


def _short(value) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
