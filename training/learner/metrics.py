"""Display of a training run: its progress bar, its evaluations in words, TensorBoard, and the learning curves."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Dict

import numpy as np

from applr_ros1.common.files import write_bytes
from training.replay.store import TrajectoryStore
from training.trials.periodic import THETA0, PeriodicEvaluation

EPISODE = ("return", "length", "success", "collided", "time_s")


class TensorBoardLog:
    """TensorBoard events in the run's folder.

    Args:
        folder: of the run.
        step: where it goes on; what a killed run wrote behind it is dropped.
    """

    def __init__(self, folder: Path, step: int):
        from torch.utils.tensorboard import SummaryWriter

        self.writer: Any = SummaryWriter(str(Path(folder) / "tensorboard"), purge_step=step + 1)

    def scalars(self, prefix: str, values: Dict[str, Any], step: int) -> None:
        """The finite numbers among `values`, as prefix/name."""
        for name, value in values.items():
            if isinstance(value, (int, float)) and np.isfinite(value):
                self.writer.add_scalar(f"{prefix}/{name}", value, step)

    def episode(self, info: Dict[str, Any], step: int) -> None:
        """A training episode: its return, and what each term of the reward had in it."""
        self.scalars("episode", {name: info.get(name) for name in EPISODE}, step)
        terms = info.get("terms")
        self.scalars("reward", terms if isinstance(terms, dict) else {}, step)

    def round(self, summary: Dict[str, Any]) -> None:
        """A round of the periodic evaluation."""
        prefix = "default_dwa" if summary["round"] == THETA0 else "held_out"
        self.scalars(prefix, {name: summary.get(name) for name in (*EPISODE, "score")}, summary["step"])


def mean(values: Any) -> float:
    """The mean of the numbers among `values`; NaN where there is none."""
    numbers = [float(value) for value in values if isinstance(value, (bool, int, float))]
    return float(np.mean(numbers)) if numbers else float("nan")


def describe(summary: Dict[str, Any]) -> str:
    """A round of the periodic evaluation in one line."""
    who = "default DWA" if summary["round"] == THETA0 else f"evaluation at {summary['step']:,}"
    text = f"{who}: return {summary['return']:.2f}, length {summary['length']:.2f}"
    if "success" in summary:
        time = "-" if summary["time_s"] is None else f"{summary['time_s']:.2f}"
        text += f", success {summary['success']:.3f}, collision {summary['collided']:.3f}, time {time} s"
        text += f", score {summary['score']:.2f} s"
    return text + f" ({summary['trials']} trials){', the best so far' if summary['best'] else ''}"


def draw_curves(path: Path, store: TrajectoryStore, evaluation: PeriodicEvaluation, period: float) -> None:
    """The paper's figure: episode length and return averaged over 100 episodes, or a hundredth of them if more.

    The evaluations are dots, that of default DWA is a dashed red line; period: decision period [s].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, StrMethodFormatter

    figure = Figure(figsize=(10, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    rows = np.array([[i["transitions"], i.get("length", 0), i.get("return", 0)] for i in store.infos()], np.float64)
    dots = [r for r in evaluation.here if r["round"] != THETA0]
    columns = (("length", f"episode length [decisions of {period} s]"), ("return", "episode return"))
    for column, (axes, (name, label)) in enumerate(zip(figure.subplots(1, 2), columns), 1):
        if len(rows):
            n = min(max(100, len(rows) // 100), 1 + len(rows) // 5)
            smooth = np.convolve(rows[:, column], np.ones(n) / n, "valid")
            axes.plot(
                np.cumsum(rows[:, 0])[n - 1 :], smooth, lw=1.2, label=f"training, mean of {n} episodes (with noise)"
            )
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
    figure.savefig(buffer, format="png", dpi=110)
    write_bytes(path, buffer.getvalue())
