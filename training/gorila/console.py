"""What a training shows: its progress line, its evaluations in words, and TensorBoard. train.py holds them."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np

from training.evaluation.periodic import THETA0


class Board:
    """TensorBoard events, where the package is there."""

    def __init__(self, folder, step: int):
        try:
            from torch.utils.tensorboard import SummaryWriter

            self.writer = SummaryWriter(str(Path(folder) / "tensorboard"), purge_step=step)
        except ImportError:
            print("no TensorBoard here: its events are not written", file=sys.stderr)
            self.writer = None

    def scalars(self, prefix: str, values: Dict[str, Any], step: int) -> None:
        for name, value in values.items():
            if self.writer and isinstance(value, (int, float)) and np.isfinite(value):
                self.writer.add_scalar("%s/%s" % (prefix, name), value, step)

    def round(self, summary) -> None:
        prefix = "default_dwa" if summary["round"] == THETA0 else "held_out"
        names = ("return", "length", "success", "collided", "time_s", "score")
        self.scalars(prefix, {name: summary.get(name) for name in names}, summary["step"])

    def close(self) -> None:
        if self.writer:
            self.writer.close()


class ProgressLine:
    """One line that is written over on a terminal, and every half minute a new one elsewhere."""

    def __init__(self):
        self.terminal = sys.stdout.isatty()
        self.every = 1.0 if self.terminal else 30.0
        self._next = time.monotonic() + 1.0
        self._last: Optional[Any] = None
        self._shown = False

    def due(self) -> bool:
        return time.monotonic() >= self._next

    def rates(self, now: float, counts: Dict[str, int]) -> Dict[str, float]:
        before, self._last = self._last or (now, counts), (now, counts)
        seconds = now - before[0]
        return {name: (counts[name] - before[1][name]) / seconds if seconds > 0 else 0.0 for name in counts}

    def show(self, text: str) -> None:
        self._next = time.monotonic() + self.every
        if self.terminal:
            width = os.get_terminal_size().columns - 1 if sys.stdout.isatty() else 200
            print("\r\x1b[K" + text[:width], end="", flush=True)
            self._shown = True
        else:
            print(text, flush=True)

    def say(self, text: str) -> None:
        self.close()
        print(text, flush=True)

    def close(self) -> None:
        if self._shown:
            print()
            self._shown = False


def describe(summary) -> str:
    who = "default DWA" if summary["round"] == THETA0 else "evaluation at %s" % format(summary["step"], ",")
    text = "%s: return %.2f, length %.2f" % (who, summary["return"], summary["length"])
    if "success" in summary:
        text += ", success %.3f, contact %.3f, time %s s, score %.2f s" % (
            summary["success"],
            summary["collided"],
            "-" if summary["time_s"] is None else "%.2f" % summary["time_s"],
            summary["score"],
        )
    return text + " (%d trials)%s" % (summary["trials"], ", the best so far" if summary["best"] else "")


def clock(seconds: float) -> str:
    if not 0.0 <= seconds < 1e8:
        return "?" if not seconds < 0.0 else "0:00:00"
    return "%d:%02d:%02d" % (seconds // 3600, seconds // 60 % 60, seconds % 60)
