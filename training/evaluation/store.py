"""An evaluation's folder: trials.csv and measures.csv, a row per trial in the plan's order, evaluation.json (what was
asked), traces/. evaluate.py appends, the report reads. A kill at any moment loses only trials that were under way.
"""

from __future__ import annotations

import base64
import csv
import io
import json
import os
import re
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, read_bytes, read_json, write_bytes, write_json
from training.evaluation.trials import COLUMNS, KEY, MEASURES, WEIGHTS_COLUMN, Task
from training.storage import Lock, make_folder

OLDER = {"weights": ["per_metre"], "planner": "ours"}  # what evaluations drove that do not name them
TRIALS, MEASURES_FILE, SETTINGS, TRACES = "trials.csv", "measures.csv", "evaluation.json", "traces"


class Store:
    """The folder, locked for this process. `settings`: what must be the same when an evaluation is continued."""

    def __init__(self, out, settings: Dict[str, Any], plan: Sequence[Task]):
        self.folder = make_folder(out)
        self._plan = plan
        self._several = len({task.weights for task in plan}) > 1  # then the last column names each trial's weights
        more = (WEIGHTS_COLUMN,) if self._several else ()
        self._lock = Lock(self.folder, "evaluate.py")
        try:
            self.done = self._check(settings, plan)
            self._files = [
                _Table(self.folder / TRIALS, COLUMNS + more, self.done),
                _Table(self.folder / MEASURES_FILE, MEASURES + more, self.done),
            ]
        except BaseException:
            self._lock.release()
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
                    raise StorageError(
                        "%s: was begun with another %s (%s, now %s); give another --out, or the same "
                        "options" % (self.folder, name, _short(there), _short(settings[name]))
                    )
        done = min(len(r) for r in rows)
        if done > len(plan):
            raise StorageError(
                "%s: holds %d trials, more than the %d asked for; give another --out or more --trials"
                % (self.folder, done, len(plan))
            )
        for number, (row, task) in enumerate(zip(rows[0][:done], plan)):
            if tuple(row[: len(KEY)]) != task.key or rows[1][number][: len(KEY)] != row[: len(KEY)]:
                raise StorageError(
                    "%s: line %d is trial %s, but this evaluation's is %s; give another --out"
                    % (self.folder / TRIALS, number + 2, "/".join(row[:3]), "/".join(task.key[:3]))
                )
        self._settings = dict(read_json(path) if path.exists() else {}, **settings)
        write_json(path, self._settings)
        return done

    def append(self, answer: Dict[str, Any]) -> None:
        """The next trial of the plan. Its row in trials.csv comes last: what is there is whole."""
        more = [self._plan[self.done].weights] if self._several else []
        if answer["trace"]:
            folder = make_folder(self.folder / TRACES)
            write_bytes(folder / trace_name(*answer["row"][:3], *more), base64.b64decode(answer["trace"]))
        self._files[1].append(answer["measures"] + more)
        self._files[0].append(answer["row"] + more)
        self.done += 1

    def finish(self, seconds: float, **more: Any) -> None:
        """Notes how long was worked on it, in all sessions together."""
        self._settings["wall_s"] = round(self._settings.get("wall_s", 0.0) + seconds, 1)
        self._settings.update(more)
        write_json(self.folder / SETTINGS, self._settings)

    def close(self) -> None:
        for file in self._files:
            file.close()
        self._lock.release()


class _Table:
    """A CSV that rows are appended to, each flushed to disk; opened, it holds its header and `keep` rows."""

    def __init__(self, path: Path, columns: Sequence[str], keep: int):
        self.path = path
        text = _lines([columns] + read_rows(path, columns)[:keep])
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


def read_rows(path, columns: Sequence[str]) -> List[List[str]]:
    """The whole rows of a CSV of ours; a torn tail is left out. [] where there is no file. A row is as long as
    `columns`, or one longer where its last cell names the weights (WEIGHTS_COLUMN). StorageError when the file is of
    another kind, or damaged before its end.
    """
    path = Path(path)
    if not path.exists():
        return []
    text = read_bytes(path).decode("utf-8", "replace")
    whole = text[: text.rfind("\n") + 1]
    rows = list(csv.reader(io.StringIO(whole.replace("\0", "?"))))
    if not rows:
        return []
    if rows[0] == [*columns, WEIGHTS_COLUMN]:
        columns = rows[0]
    if rows[0] != list(columns):
        raise StorageError(
            "%s: its columns are %s, expected %s; give another folder"
            % (path, _short(",".join(rows[0])), ",".join(columns))
        )
    good = 1
    while good < len(rows) and len(rows[good]) == len(columns) and rows[good][2].isdigit():
        good += 1
    if any(len(row) == len(columns) and row[2].isdigit() for row in rows[good:]):
        raise StorageError("%s: line %d is damaged, with good lines behind it; mend or remove it" % (path, good + 1))
    return rows[1:good]


def trace_name(world: str, method: str, trial, weights: str = "") -> str:
    """File name of a trial's trace; weights: given where several are driven."""
    parts = [world, method, trial] + [weights] * bool(weights)
    return "__".join(re.sub(r"[^\w.+-]", "-", str(part)) for part in parts) + ".npz"


def read_trace(folder, world: str, method: str, trial: int, weights: str = "") -> Optional[Dict[str, Any]]:
    """{"time", "pose", "twist", "theta"} of a trial whose trace was kept, else None."""
    import numpy as np

    path = Path(folder) / TRACES / trace_name(world, method, trial, weights)
    try:
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in ("time", "pose", "twist", "theta")}
    except (OSError, ValueError, KeyError):
        return None


def _lines(rows) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue().encode()


def _short(value) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
