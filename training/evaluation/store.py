"""An evaluation's folder, which a kill at any moment costs only the trials that were under way.

trials.csv and measures.csv hold a row per trial in the plan's order, evaluation.json what was asked, traces/ the driven
paths. evaluate.py appends, the report reads.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
from pathlib import Path
from typing import Any, Dict, Iterable, List, Optional, Sequence

import numpy as np

from applr_ros1.common.arrays import unpack_npz
from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, read_bytes, read_json, write_bytes, write_json
from applr_ros1.policy.decision import PERIOD
from applr_ros1.robots import JACKAL
from training.evaluation.trials import COLUMNS, KEY, MEASURES, WEIGHTS_COLUMN, described, key_of
from training.storage import Lock, make_folder
from training.workers.tasks import Trial, TrialResult

OLDER = {
    "weights": ["per_metre"],
    "planner": "ours",
    "robot": described(JACKAL),
    "monitor": False,
    "as_they_are": True,
    "worlds_with_movers": [],
}  # what evaluations drove that do not name them
TRIALS, MEASURES_FILE, SETTINGS, TRACES = "trials.csv", "measures.csv", "evaluation.json", "traces"
MAX_TRACE = 2**26  # bytes, packed and unpacked


class Store:
    """The folder, locked for this process. `settings`: what must be the same when an evaluation is continued."""

    def __init__(self, out, settings: Dict[str, Any], plan: Sequence[Trial]):
        self.folder = make_folder(out)
        self._several = len({trial.weights for trial in plan}) > 1  # then the last column names each trial's weights
        more = (WEIGHTS_COLUMN,) if self._several else ()
        self._lock = Lock(self.folder, "evaluate.py")
        try:
            self.done = self._begun_with = self._check(settings, plan)
            self._files = [
                _Table(self.folder / TRIALS, COLUMNS + more, self.done),
                _Table(self.folder / MEASURES_FILE, MEASURES + more, self.done),
            ]
        except BaseException:
            self._lock.close()
            raise

    def _check(self, settings, plan) -> int:
        """How many trials are already there. StorageError where they are another evaluation's."""
        path = self.folder / SETTINGS
        rows = [read_rows(self.folder / TRIALS, COLUMNS), read_rows(self.folder / MEASURES_FILE, MEASURES)]
        if rows[0] and not path.exists():
            raise StorageError("%s: holds trials, but %s is missing; give another --out" % (self.folder, SETTINGS))
        if path.exists():
            stored = read_json(path)
            for name in settings:
                there = stored.get(name, OLDER.get(name)) if isinstance(stored, dict) else None
                if json.loads(json.dumps(settings[name])) != there:
                    remedy = "give another --out, or the same options"
                    if name == "methods":
                        remedy += "; training.report --join shows the methods of two folders together"
                    raise StorageError(
                        "%s: was begun with another %s (%s, now %s); %s"
                        % (self.folder, name, _short(there), _short(settings[name]), remedy)
                    )
        done = min(len(r) for r in rows)
        if done > len(plan):
            raise StorageError(
                "%s: holds %d trials, more than the %d asked for; give another --out or more --trials"
                % (self.folder, done, len(plan))
            )
        for number, (row, measures, trial) in enumerate(zip(rows[0][:done], rows[1], plan)):
            key = dict(zip(KEY, key_of(trial)))
            if any(row[name] != cell or measures[name] != cell for name, cell in key.items()):
                raise StorageError(
                    "%s: line %d is trial %s, but this evaluation's is %s; give another --out"
                    % (
                        self.folder / TRIALS,
                        number + 2,
                        "/".join(row[name] for name in KEY[:3]),
                        "/".join(key[name] for name in KEY[:3]),
                    )
                )
        self._settings = dict(read_json(path) if path.exists() else {}, **settings)
        write_json(path, self._settings)
        return done

    def append(self, trial: Trial, result: TrialResult, trace: bytes = b"") -> None:
        """The next trial of the plan. Its row in trials.csv comes last: what is there is whole."""
        if trace:
            name = trace_name(trial.world, trial.method, trial.trial, trial.weights if self._several else "")
            write_bytes(make_folder(self.folder / TRACES) / name, trace)
        for file in reversed(self._files):
            file.append([_cell(getattr(trial if hasattr(trial, name) else result, name)) for name in file.columns])
        self.done += 1

    def finish(self, seconds: float, provenance: Optional[Dict[str, Any]] = None, **more: Any) -> None:
        """Notes how long was worked on it, in all sessions together, and where this session's trials come from."""
        self._settings["wall_s"] = round(self._settings.get("wall_s", 0.0) + seconds, 1)
        if provenance is not None:
            session = dict(provenance, trials=self.done - self._begun_with, wall_s=round(seconds, 1))
            self._settings["provenance"] = [*self._settings.get("provenance", []), session]
        self._settings.update(more)
        write_json(self.folder / SETTINGS, self._settings)

    def close(self) -> None:
        """Closes the files and lets go of the folder."""
        for file in self._files:
            file.close()
        self._lock.close()


class _Table:
    """A CSV that rows are appended to, each flushed to disk; opened, it holds its header and `keep` rows."""

    def __init__(self, path: Path, columns: Sequence[str], keep: int):
        self.path, self.columns = path, columns
        text = _lines([columns, *(row.values() for row in read_rows(path, columns)[:keep])])
        if not path.exists() or path.read_bytes() != text:
            write_bytes(path, text)
        try:
            self._file = os.open(str(path), os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (path, reason(error))) from None

    def append(self, row: Sequence[str]) -> None:
        data = _lines([row])
        try:
            if os.write(self._file, data) != len(data):
                raise OSError(28, "no space left on device")
            os.fsync(self._file)
        except OSError as error:
            raise StorageError(
                "%s: cannot be written (%s); the trials above are safe, the same command continues"
                % (self.path, reason(error))
            ) from None

    def close(self) -> None:
        os.close(self._file)


def read_rows(path: os.PathLike | str, columns: Sequence[str]) -> List[Dict[str, str]]:
    """The whole rows of a CSV of ours by their columns' names; a torn tail is left out. [] where there is no file.

    A row has the given columns, and WEIGHTS_COLUMN too where several kinds of weights were driven.

    Raises:
        StorageError: when the file is of another kind, or damaged before its end.
    """
    path = Path(path)
    if not path.exists():
        return []
    text = read_bytes(path).decode("utf-8", "replace")
    lines = text[: text.rfind("\n") + 1]
    rows = list(csv.reader(io.StringIO(lines.replace("\0", "?"))))
    if not rows:
        return []
    if rows[0] == [*columns, WEIGHTS_COLUMN]:
        columns = rows[0]
    if rows[0] != list(columns):
        raise StorageError(
            "%s: its columns are %s, expected %s; give another folder"
            % (path, _short(",".join(rows[0])), ",".join(columns))
        )

    def whole(row: List[str]) -> bool:
        return len(row) == len(columns) and row[columns.index("trial")].isdigit()

    good = 1
    while good < len(rows) and whole(rows[good]):
        good += 1
    if any(whole(row) for row in rows[good:]):
        raise StorageError("%s: line %d is damaged, with good lines behind it; mend or remove it" % (path, good + 1))
    return [dict(zip(columns, row)) for row in rows[1:good]]


def flag(cell: str) -> bool:
    """True or False of a cell. Raises ValueError."""
    if cell not in ("True", "False"):
        raise ValueError("%r is neither True nor False" % cell)
    return cell == "True"


def _cell(value: Any) -> str:
    return str(round(value, 4) if isinstance(value, float) else value)


def trace_name(world: str, method: str, trial: int, weights: str = "") -> str:
    """File name of a trial's trace; weights: given where several are driven."""
    parts = [world, method, trial] + [weights] * bool(weights)
    return "__".join(re.sub(r"[^\w.+-]", "-", str(part)) for part in parts) + ".npz"


def read_trace(
    folder: os.PathLike | str, world: str, method: str, trial: int, weights: str = ""
) -> Optional[Dict[str, Any]]:
    """{"time", "pose", "twist", "theta", "decided"} of a trial whose trace was kept, else None.

    decided: when each row of theta was chosen [s]; traces of older evaluations have one every 2 s.
    """
    path = Path(folder) / TRACES / trace_name(world, method, trial, weights)
    try:
        arrays = unpack_npz(read_bytes(path, MAX_TRACE), str(path), MAX_TRACE, StorageError)
        found = {name: arrays[name] for name in ("time", "pose", "twist", "theta")}
        return dict(found, decided=arrays.get("decided", PERIOD * np.arange(len(found["theta"]))))
    except (StorageError, KeyError):
        return None


def _lines(rows: Iterable[Iterable[str]]) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue().encode()


def _short(value) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
