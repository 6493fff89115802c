"""Evaluation while training: rounds of trials on held-out worlds, and which actor was best. train.py holds one.

The first round drives the planner's default parameters: the line in the learning curves, and what is to be beaten.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Optional

import numpy as np

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, write_bytes

THETA0 = -1  # number of the round that drives the default


class Rounds:
    """worlds: indices to drive; trials: in each; setting: which worlds and simulator, in words. A round is due every
    `every` steps (transitions; offline: updates).
    """

    def __init__(
        self, folder, worlds: List[int], trials: int, every: int, seed: int, contact_seconds: float, setting: str = ""
    ):
        self.path = Path(folder) / "evaluations.jsonl"
        self.worlds, self.trials, self.every, self.seed = worlds, trials, every, seed
        self.contact_seconds, self.setting = contact_seconds, setting
        self.history: List[Dict[str, Any]] = _read(self.path)
        self.number: Optional[int] = None  # of the round under way
        self._results: List[Dict[str, Any]] = []
        self._open = 0

    # -- when --------------------------------------------------------------------------------------
    def due(self, step: int) -> Optional[int]:
        """The number of the round to begin now, or None."""
        if self.number is not None or not self.worlds:
            return None
        if self.default is None:
            return THETA0
        number = step // self.every
        return number if number > max([r["round"] for r in self.history] + [0]) else None

    def begin(self, number: int, step: int, version: int) -> List[Dict[str, Any]]:
        """The round's tasks."""
        self.number, self._results = number, []
        self.step, self.version = step, version
        tasks = [
            {
                "kind": "evaluate",
                "round": number,
                "world": world,
                "trial": trial,
                "seed": self.seed,
                "theta0": number == THETA0,
            }
            for trial in range(self.trials)
            for world in self.worlds
        ]
        self._open = len(tasks)
        return tasks

    def add(self, result: Optional[Dict[str, Any]]) -> Optional[Dict[str, Any]]:
        """A trial's result (None: it failed by an error). The round's summary when it was the last, else None."""
        self._open -= 1
        if result is not None:
            self._results.append(result)
        if self._open > 0:
            return None
        summary = dict(self._summary(), round=self.number, step=self.step, version=self.version, setting=self.setting)
        self.number = None
        if "score" not in summary:
            raise StorageError("every trial of an evaluation failed; see the messages above")
        summary["best"] = summary["round"] != THETA0 and summary["score"] < min(
            [r["score"] for r in self.here if r["round"] != THETA0], default=float("inf")
        )
        self.history.append(summary)
        _write(self.path, self.history)
        return summary

    @property
    def here(self) -> List[Dict[str, Any]]:
        """The rounds of the present setting: another simulator's times are no rivals."""
        return [r for r in self.history if r["setting"] == self.setting]

    # -- what ----------------------------------------------------------------------------------------
    @property
    def default(self) -> Optional[Dict[str, Any]]:
        """The default parameters' summary."""
        return next((r for r in self.here if r["round"] == THETA0), None)

    @property
    def best(self) -> Optional[Dict[str, Any]]:
        return next((r for r in reversed(self.here) if r["best"]), None)

    def _summary(self) -> Dict[str, Any]:
        """Means over the round's trials. score [s]: mean time, a failure counting its limit, a contact some seconds."""
        results = self._results
        if not results:
            return {}
        summary = {"trials": len(results), "return": _mean(results, "return"), "length": _mean(results, "length")}
        if "time_s" in results[0]:
            won = [r for r in results if r["success"]]
            summary.update(
                success=_mean(results, "success"),
                collided=_mean(results, "collided"),
                time_s=_mean(won, "time_s") if won else None,
                score=float(
                    np.mean(
                        [
                            (r["time_s"] if r["success"] else 100.0) + self.contact_seconds * r["collided"]
                            for r in results
                        ]
                    )
                ),
            )
        else:
            summary["score"] = -summary["return"]
        return summary


def _mean(results, name):
    return float(np.mean([float(r[name]) for r in results]))


def _read(path) -> List[Dict[str, Any]]:
    if not path.exists():
        return []
    try:
        return [json.loads(line) for line in path.read_text().splitlines() if line]
    except (OSError, ValueError) as error:
        raise StorageError("%s: cannot be read (%s)" % (path, error)) from None


def _write(path, lines) -> None:
    write_bytes(path, "".join(json.dumps(line) + "\n" for line in lines).encode())


class Episodes:
    """episodes.csv: a row per training episode. `keep` rows of an earlier part of the run stay when it is resumed."""

    COLUMNS = ("transitions", "return", "length", "success", "collided", "time_s", "world", "sigma", "version")

    def __init__(self, folder, keep: int):
        self.path = Path(folder) / "episodes.csv"
        lines = []
        try:
            if self.path.exists():
                lines = self.path.read_text().splitlines()[1 : keep + 1]
            text = "\n".join([",".join(self.COLUMNS)] + lines) + "\n"
            write_bytes(self.path, text.encode())
            self._file = open(self.path, "a", buffering=1)  # noqa: SIM115
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self.path, reason(error))) from None
        self.rows = [self._parse(line) for line in lines]

    def add(self, transitions: int, info: Dict[str, Any]) -> None:
        row = dict(info, transitions=transitions)
        self.rows.append(tuple(float(row.get(name, "nan") or 0) for name in self.COLUMNS[:5]))
        try:
            self._file.write(",".join(_cell(row.get(name)) for name in self.COLUMNS) + "\n")
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self.path, reason(error))) from None

    def recent(self, name: str, n: int = 100) -> float:
        rows = self.rows[-n:]
        return float(np.mean([row[self.COLUMNS.index(name)] for row in rows])) if rows else float("nan")

    def _parse(self, line):
        return tuple(float(cell) if cell else float("nan") for cell in line.split(",")[:5])

    def close(self):
        self._file.close()


def _cell(value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return "%.6g" % value if isinstance(value, float) else str(value).replace(",", " ")


def draw_curves(path, episodes: Episodes, rounds: Rounds, window: int = 100) -> None:
    """The paper's figure: episode length and return averaged over 100 episodes, default DWA as a dashed red line, and
    the rounds on held-out worlds as dots. Does nothing where matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return
    import io

    figure = Figure(figsize=(10, 3.6), layout="constrained")
    rows = np.array(episodes.rows, dtype=np.float64).reshape(-1, 5)
    dots = [r for r in rounds.here if r["round"] != THETA0]
    for axes, (name, column, label) in zip(
        figure.subplots(1, 2), (("length", 2, "episode length [two-second decisions]"), ("return", 1, "episode return"))
    ):
        if len(rows):
            n = min(window, 1 + len(rows) // 5)
            smooth = np.convolve(rows[:, column], np.ones(n) / n, "valid")
            axes.plot(rows[n - 1 :, 0], smooth, lw=1.2, label="training, mean of %d episodes (with noise)" % n)
        if dots:
            axes.plot([r["step"] for r in dots], [r[name] for r in dots], "o-", ms=3.5, lw=0.8, label="held-out worlds")
        if rounds.default:
            axes.axhline(rounds.default[name], color="tab:red", ls="--", label="default DWA, held-out worlds")
        axes.set(xlabel="transitions", ylabel=label)
        axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=110)
    write_bytes(path, buffer.getvalue())
