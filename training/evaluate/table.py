"""Table of trials on disk, in which evaluations, training rounds, searches and verdicts keep their results.

The folder has trials.csv with a row for each trial, appended once it was driven, evaluation.json with the settings, and
the driven paths in traces/. If the process is killed, only the trials that were being driven are lost.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
from dataclasses import astuple, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Iterable, Optional, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, read_json, write_bytes, write_json
from applr_ros1.drives.drive import Drive
from training.common.folders import Lock, make_folder
from training.evaluate.trial import Result, Trial

if TYPE_CHECKING:
    import pandas as pd

TRIALS, SETTINGS, TRACES = "trials.csv", "evaluation.json", "traces"
COLUMNS: Dict[str, Any] = {
    "world": "str",
    "method": "str",
    "trial": "int",
    "seed": "int",
}  # types by column
KEY = tuple(COLUMNS)
COLUMNS.update({field.name: field.type for field in fields(Result)})
NAN = {name: ["nan"] for name, kind in COLUMNS.items() if kind == "float"}


def read_trials(path: os.PathLike[str] | str) -> pd.DataFrame:
    """Return a table of trials with the types of COLUMNS; empty if the file is missing or empty.

    An incomplete last line is left out: the process was killed while writing it.
    """
    import pandas as pd

    data = read_bytes(path) if Path(path).exists() else b""
    whole = data[: data.rfind(b"\n") + 1] or (",".join(COLUMNS) + "\n").encode()
    options: Dict[str, Any] = {"dtype": COLUMNS, "keep_default_na": False, "na_values": NAN}
    return pd.read_csv(io.BytesIO(whole), usecols=list(COLUMNS), **options)[[*COLUMNS]].round(4)


class Trials:
    """Folder with a table of trials, locked for this process until closed. Numbers have four decimals.

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
        self.folder, self.added = make_folder(folder), 0
        path = self.folder / SETTINGS
        if not path.exists():
            write_json(path, settings)
        self.notes: Dict[str, Any] = read_json(path)
        for name, value in json.loads(json.dumps(settings)).items():
            if value != self.notes.get(name):
                raise ApplrError(
                    f"{self.folder} has another {name}: give another --out, or the same {name}"
                )
        self._lock = Lock(self.folder, "evaluate.py")
        rows = read_trials(self.folder / TRIALS).itertuples(index=False, name=None)
        self._results = {row[: len(KEY)]: Result(*row[len(KEY) :]) for row in rows}
        self.order([])

    def __enter__(self) -> Trials:
        return self

    def __exit__(self, *error: Any) -> None:
        self._lock.close()

    def find(self, trial: Trial) -> Optional[Result]:
        """Return the result of a trial, or None if it was not driven yet."""
        return self._results.get(_key(trial))

    def add(self, trial: Trial, result: Result, trace: bytes = b"") -> Result:
        """Store a trial and return its rounded result. The row is written last, so that each row has its trace."""
        if trace:
            write_bytes(
                make_folder(self.folder / TRACES)
                / trace_name(trial.world, trial.method, trial.trial),
                trace,
            )
        values: Dict[str, Any] = {
            k: round(v, 4) if isinstance(v, float) else v for k, v in vars(result).items()
        }
        kept = self._results[_key(trial)] = Result(**values)
        self.added += 1
        with open(self.folder / TRIALS, "ab") as file:
            file.write(_lines([(*_key(trial), *astuple(kept))]))
        return kept

    def order(self, plan: Sequence[Trial]) -> None:
        """Rewrite the file with the trials of a plan first, in its order, and then all others."""
        keys = [*filter(self._results.__contains__, map(_key, plan)), *self._results]
        rows = [(*key, *astuple(self._results[key])) for key in dict.fromkeys(keys)]
        write_bytes(self.folder / TRIALS, _lines([tuple(COLUMNS), *rows]))

    def note(self, **values: Any) -> None:
        """Store JSON values beside the settings."""
        self.notes.update(values)
        write_json(self.folder / SETTINGS, self.notes)


def trace_name(world: str, method: str, trial: int) -> str:
    """Return the file name of a trial's trace."""
    return (
        "__".join(re.sub(r"[^\w.+-]", "-", str(part)) for part in (world, method, trial)) + ".npz"
    )


def read_trace(
    folder: os.PathLike[str] | str, world: str, method: str, trial: int
) -> Optional[Drive]:
    """Return the driven path of a trial as a Drive, or None if it was not kept."""
    path = Path(folder) / TRACES / trace_name(world, method, trial)
    return Drive.unpack(read_bytes(path)) if path.exists() else None


def _key(trial: Trial) -> Any:
    return tuple(getattr(trial, name) for name in KEY)


def _lines(rows: Iterable[Sequence[Any]]) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue().encode()
