"""Display of a training run: its progress bar, its evaluations in words, and TensorBoard."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict

import numpy as np

from training.evaluation.periodic import THETA0

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
