"""Table of trials on disk, which evaluations, training rounds, searches and verdicts write.

The folder has trials.csv with a row for each trial, appended once it was driven, evaluation.json
with the settings, and the driven paths in traces/. If the process is killed, only the trials that
were being driven are lost.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
from dataclasses import astuple, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Optional, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, read_json, reading, write_bytes, write_json
from applr_ros1.drives.drive import Drive
from training.common.folders import Lock, make_folder
from training.evaluate.differences import difference
from training.evaluate.trial import Result, Trial

if TYPE_CHECKING:
    import pandas as pd

# Names of files and folders in the folder of a table
TRIALS = "trials.csv"
SETTINGS = "evaluation.json"
TRACES = "traces"
# Types of the columns: those that identify a trial, then those of its result
COLUMNS: Dict[str, Any] = {"world": "str", "method": "str", "trial": "int", "seed": "int"}
KEY = tuple(COLUMNS)
# Only numbers can be missing: a reason or a world may be called "nan".
NAN: Dict[str, Any] = {}
for _field in fields(Result):
    COLUMNS[_field.name] = _field.type
    if _field.type == "float":
        NAN[_field.name] = ["nan"]
DECIMALS = 4  # precision of the numbers in a table


def read_trials(path: os.PathLike[str] | str) -> pd.DataFrame:
    """Return a table of trials with the types of COLUMNS; empty if the file is missing or empty.

    An incomplete last line is left out: the process was killed while writing it.
    """
    import pandas as pd

    file_bytes = b""
    if Path(path).exists():
        file_bytes = read_bytes(path)
    whole_lines = file_bytes[: file_bytes.rfind(b"\n") + 1] or _lines([tuple(COLUMNS)])
    with reading(path):
        trials = pd.read_csv(
            io.BytesIO(whole_lines),
            usecols=list(COLUMNS),
            dtype=COLUMNS,
            keep_default_na=False,
            na_values=NAN,
        )
        # usecols keeps the order of the file.
        return trials[list(COLUMNS)].round(DECIMALS)


class TrialTable:
    """Folder with a table of trials, locked for this process until closed.

    Numbers have four decimals.

    Args:
        folder: Folder of the table, made if it is missing.
        settings: Settings that must be the same when the table is continued, as JSON values.

    Attributes:
        notes: The settings, and the values added by `note`.
        added: Number of trials added since the table was opened.

    Raises:
        ApplrError: The folder belongs to an evaluation with other settings, or to another process.
    """

    def __init__(self, folder: os.PathLike[str] | str, settings: Dict[str, Any]):
        self.folder = make_folder(folder)
        self.added = 0
        settings_file = self.folder / SETTINGS
        if not settings_file.exists():
            write_json(settings_file, settings)
        with reading(settings_file):
            self.notes: Dict[str, Any] = dict(read_json(settings_file))
        # As JSON, because a tuple would differ from the list that was read.
        as_json = json.loads(json.dumps(settings))
        problem = difference(self.folder, self.notes, as_json)
        if problem:
            raise ApplrError(problem)
        self._lock = Lock(self.folder, "./applr evaluate")
        self._results: Dict[Any, Result] = {}
        for row in read_trials(self.folder / TRIALS).itertuples(index=False, name=None):
            self._results[row[: len(KEY)]] = Result(*row[len(KEY) :])
        self.order([])  # Without the incomplete last line, to which add() would append.

    def __enter__(self) -> TrialTable:
        return self

    def __exit__(self, *error: Any) -> None:
        self._lock.close()

    def missing(self, trials: Sequence[Trial]) -> List[Trial]:
        """Return the trials that were not driven yet, each once."""
        unique = dict.fromkeys(trials)
        return [trial for trial in unique if _key(trial) not in self._results]

    def result(self, trial: Trial) -> Result:
        """Return the result of a trial that was driven."""
        return self._results[_key(trial)]

    def add(self, trial: Trial, result: Result, trace: bytes = b"") -> Result:
        """Store a trial and return its rounded result."""
        # The trace comes first, so that each row has its trace even if the process is killed.
        if trace:
            file_name = trace_name(trial.world, trial.method, trial.trial)
            write_bytes(make_folder(self.folder / TRACES) / file_name, trace)
        values: Dict[str, Any] = dict(vars(result))
        for name, value in values.items():
            if isinstance(value, float):
                values[name] = round(value, DECIMALS)
        rounded = Result(**values)
        self._results[_key(trial)] = rounded
        self.added += 1
        with open(self.folder / TRIALS, "ab") as file:
            file.write(_lines([self._row(_key(trial))]))
        return rounded

    def order(self, plan: Sequence[Trial]) -> None:
        """Rewrite the file with the trials of a plan first, in its order, and then all others."""
        planned = filter(self._results.__contains__, map(_key, plan))
        keys = dict.fromkeys([*planned, *self._results])
        write_bytes(self.folder / TRIALS, _lines([tuple(COLUMNS), *map(self._row, keys)]))

    def _row(self, key: Any) -> Sequence[Any]:
        """Return the row of a trial."""
        return (*key, *astuple(self._results[key]))

    def note(self, **values: Any) -> None:
        """Store JSON values beside the settings."""
        self.notes.update(values)
        write_json(self.folder / SETTINGS, self.notes)


def trace_name(world: str, method: str, trial: int) -> str:
    """Return the file name of a trial's trace."""
    # A world or a method may be a path or a module:Class.
    return re.sub(r"[^\w.+-]", "-", f"{world}__{method}__{trial}.npz")


def read_trace(
    folder: os.PathLike[str] | str, world: str, method: str, trial: int
) -> Optional[Drive]:
    """Return the driven path of a trial as a Drive, or None if it was not kept."""
    path = Path(folder) / TRACES / trace_name(world, method, trial)
    if not path.exists():
        return None
    with reading(path):
        return Drive.unpack(read_bytes(path))


def _key(trial: Trial) -> Any:
    """Return the values that identify a trial."""
    return trial.world, trial.method, trial.trial, trial.seed


def _lines(rows: Iterable[Sequence[Any]]) -> bytes:
    """Return rows as lines of CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue().encode()
