"""An evaluation's folder, which a kill at any moment costs only the trials that were under way.

trials.sqlite holds the result of each trial; trials.csv and measures.csv, a row per trial in the plan's order, are
written from it. evaluation.json says what was asked, traces/ holds the driven paths. evaluate.py writes, the report
reads; searches keep their trials in such a table too.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import sqlite3
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Dict, Iterable, List, Optional, Sequence

import numpy as np

from applr_ros1.common.files import StorageError, read_bytes, read_json, sha256, write_bytes, write_json
from training.common.folders import Lock, make_folder
from training.evaluation.plan import COLUMNS, MEASURES, Trial, TrialResult

TABLE, TRIALS, MEASURES_FILE = "trials.sqlite", "trials.csv", "measures.csv"
SETTINGS, TRACES = "evaluation.json", "traces"
SHOWN_EVERY = 10.0  # [s] between two writings of the CSV files while trials come in


class TrialTable:
    """Results of trials in an SQLite file: one row, the trial, how it went and the checksum of both, for each.

    Args:
        path: of the file, which is made where it is missing.
        setting: what beside the trial tells results apart, as JSON values.

    Raises:
        StorageError: with one line, from every method, for a file that cannot be read or written or is none of ours.
    """

    def __init__(self, path: os.PathLike | str, setting: Sequence[Any] = ()):
        self.path, self.setting = Path(path), list(setting)
        self._do("CREATE TABLE IF NOT EXISTS trials (trial TEXT PRIMARY KEY, result TEXT NOT NULL, sum TEXT NOT NULL)")
        if not self._do("SELECT 1 FROM pragma_table_info('trials') WHERE name = 'sum'"):
            raise StorageError(f"{path}: an earlier version kept these trials, without checksums; give another --out")

    def find(self, trial: Trial) -> Optional[TrialResult]:
        """The result of a trial, or None; also, and said on stderr, where its row is damaged."""
        key = self._key(trial)
        for result, found in self._do("SELECT result, sum FROM trials WHERE trial = ?", key):
            if found == sha256(key, result):
                return TrialResult(**json.loads(result))
            what = f"trial {trial.trial} of {trial.method} in {trial.world}"
            print(f"{self.path}: {what} is damaged and left out: its checksum is wrong", file=sys.stderr)
        return None

    def add(self, trial: Trial, result: TrialResult, trace: bytes = b"") -> None:
        """Keep a trial, but for its trace. It is on the disk when this returns."""
        row = self._key(trial), json.dumps(asdict(result))
        self._do("INSERT OR REPLACE INTO trials VALUES (?, ?, ?)", *row, sha256(*row))

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _key(self, trial: Trial) -> str:
        return json.dumps([self.setting, asdict(replace(trial, trace=False))])

    def _do(self, statement: str, *values: str) -> List[Any]:
        try:
            if not hasattr(self, "_connection"):
                self._connection = sqlite3.connect(str(self.path), isolation_level=None)
            return self._connection.execute(statement, values).fetchall()
        except sqlite3.Error as error:
            raise StorageError(
                f"{self.path}: cannot be used ({error}); the trials in it are safe, the same command continues"
            ) from None


class TrialStore:
    """The folder, locked for this process. `settings`: what must be the same when an evaluation is continued."""

    def __init__(self, out, settings: Dict[str, Any], plan: Sequence[Trial]):
        self.folder, self.plan = make_folder(out), plan
        self._lock = Lock(self.folder, "evaluate.py")
        try:
            self._settings = self._checked(settings)
            self.table = TrialTable(self.folder / TABLE)
            found = ((trial, self.table.find(trial)) for trial in plan)
            self.results: Dict[Trial, TrialResult] = {trial: result for trial, result in found if result is not None}
            self._begun_with = len(self.results)
            self._show()
        except BaseException:
            self._lock.close()
            raise

    def _checked(self, settings: Dict[str, Any]) -> Dict[str, Any]:
        """The settings with what else is noted. StorageError where the folder is another evaluation's."""
        path = self.folder / SETTINGS
        if not path.exists() or not (self.folder / TABLE).exists():
            if (self.folder / TRIALS).exists():
                raise StorageError(
                    f"{self.folder}: holds trials, but {SETTINGS} or {TABLE} is missing; give another --out"
                )
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

    def find(self, trial: Trial) -> Optional[TrialResult]:
        """The result of a trial of the plan, or None."""
        return self.results.get(trial)

    def add(self, trial: Trial, result: TrialResult, trace: bytes = b"") -> None:
        """Keep a trial; its row comes last: what is there is whole."""
        if trace:
            write_bytes(make_folder(self.folder / TRACES) / trace_name(trial.world, trial.method, trial.trial), trace)
        self.table.add(trial, result)
        self.results[trial] = result
        if time.monotonic() > self._shown + SHOWN_EVERY:
            self._show()

    def _show(self) -> None:
        """Writes the CSV files: the trials that were driven, in the plan's order."""
        for name, columns in ((MEASURES_FILE, MEASURES), (TRIALS, COLUMNS)):
            rows = [
                [_cell(getattr(trial if hasattr(trial, column) else result, column)) for column in columns]
                for trial, result in ((trial, self.results.get(trial)) for trial in self.plan)
                if result is not None
            ]
            write_bytes(self.folder / name, _lines([columns, *rows]))
        self._shown = time.monotonic()

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
        """Writes the CSV files, and lets go of the folder."""
        try:
            self._show()
        finally:
            self.table.close()
            self._lock.close()


def read_rows(path: os.PathLike | str, columns: Sequence[str]) -> List[Dict[str, str]]:
    """The rows of a CSV of ours by their columns' names; [] where there is no file.

    Raises:
        StorageError: when the file is of another kind, or damaged.
    """
    if not Path(path).exists():
        return []
    rows = list(csv.reader(io.StringIO(read_bytes(path).decode("utf-8", "replace").replace("\0", "?"))))
    for number, row in enumerate(rows, start=1):
        if row != list(columns) if number == 1 else len(row) != len(columns):
            raise StorageError(
                f"{path}: line {number} is {_short(','.join(row))}, expected {','.join(columns)}; give another folder"
            )
    return [dict(zip(columns, row)) for row in rows[1:]]


def flag(cell: str) -> bool:
    """True or False of a cell. Raises ValueError."""
    if cell not in ("True", "False"):
        raise ValueError(f"{cell!r} is neither True nor False")
    return cell == "True"


def _cell(value: Any) -> str:
    return str(round(value, 4) if isinstance(value, float) else value)


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
            return {name: arrays[name] for name in ("time", "pose", "twist", "theta", "decided")}
    except FileNotFoundError:
        return None


def _lines(rows: Iterable[Iterable[str]]) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue().encode()


def _short(value) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
