"""Learning curves: episodes.csv, a row per training episode, and the picture of a run. gorila/run.py keeps both."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Dict, Tuple

import numpy as np

from applr_ros1.common.errors import reason
from applr_ros1.common.files import StorageError, read_bytes, write_bytes
from training.evaluation.periodic import THETA0, PeriodicEvaluation


class EpisodeLog:
    """episodes.csv: a row per training episode.

    When a run is resumed, the rows of its first `transitions` transitions stay.
    """

    COLUMNS = ("transitions", "return", "length", "success", "collided", "time_s", "world", "sigma", "version")

    def __init__(self, folder: Path, transitions: int):
        self.path = Path(folder) / "episodes.csv"
        kept = {}  # line → its numbers
        if self.path.exists():
            lines = read_bytes(self.path).decode("utf-8", "replace").splitlines()[1:]
            rows = {line: self._parse(line) for line in lines}
            kept = {line: row for line, row in rows.items() if row and row[0] <= transitions}
        write_bytes(self.path, "".join(line + "\n" for line in [",".join(self.COLUMNS), *kept]).encode())
        try:
            self._file = open(self.path, "a", buffering=1)  # noqa: SIM115
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self.path, reason(error))) from None
        self.rows = list(kept.values())

    def add(self, transitions: int, info: Dict[str, Any]) -> None:
        """The next episode, which ended after so many transitions of the run; info: its trajectory's."""
        row = dict(info, transitions=transitions)
        self.rows.append(tuple(float(row.get(name, "nan") or 0) for name in self.COLUMNS[:5]))
        try:
            self._file.write(",".join(_cell(row.get(name)) for name in self.COLUMNS) + "\n")
        except OSError as error:
            raise StorageError("%s: cannot be written (%s)" % (self.path, reason(error))) from None

    def recent(self, name: str, n: int = 100) -> float:
        """Mean of one of the first five columns over the last n episodes."""
        rows = self.rows[-n:]
        return float(np.mean([row[self.COLUMNS.index(name)] for row in rows])) if rows else float("nan")

    def _parse(self, line: str) -> Tuple[float, ...]:
        """The first five cells of a row; () for a line that is none."""
        cells = line.split(",")
        try:
            row = tuple(float(cell or "nan") for cell in cells[:5])
        except ValueError:
            return ()
        return row if len(cells) == len(self.COLUMNS) else ()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return "%.6g" % value if isinstance(value, float) else str(value).replace(",", " ")


def draw_curves(
    path: Path, episodes: EpisodeLog, evaluation: PeriodicEvaluation, period: float, window: int = 100
) -> None:
    """The paper's figure: episode length and return averaged over `window` episodes, or a hundredth of them if more.

    The evaluations are dots, that of default DWA is a dashed red line. Does nothing where matplotlib is missing.
    period: decision period [s], which the label of the length names.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.ticker import MaxNLocator, StrMethodFormatter
    except ImportError:
        return
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    rows = np.array(episodes.rows, dtype=np.float64).reshape(-1, 5)
    dots = [r for r in evaluation.here if r["round"] != THETA0]
    length = "episode length [decisions of %g s]" % period
    for axes, (name, column, label) in zip(
        figure.subplots(1, 2), (("length", 2, length), ("return", 1, "episode return"))
    ):
        if len(rows):
            n = min(max(window, len(rows) // 100), 1 + len(rows) // 5)
            smooth = np.convolve(rows[:, column], np.ones(n) / n, "valid")
            axes.plot(rows[n - 1 :, 0], smooth, lw=1.2, label="training, mean of %d episodes (with noise)" % n)
        if dots:
            axes.plot([r["step"] for r in dots], [r[name] for r in dots], "o-", ms=3.5, lw=0.8, label="evaluations")
        if evaluation.default:
            axes.axhline(evaluation.default[name], color="tab:red", ls="--", label="default DWA, evaluation")
        axes.set(xlabel="transitions", ylabel=label)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=110)
    write_bytes(path, buffer.getvalue())
