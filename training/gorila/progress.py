"""What a training shows: its progress line, its evaluations in words, and TensorBoard. run.py holds them."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np

from training.evaluation.periodic import THETA0

NOT_HYPER = ("out", "resume", "ray_address", "tensorboard")  # options that say where a run is, not how it learns
JUDGED_BY = ("held_out/score", "held_out/success")  # what TensorBoard's table of hyper-parameters shows of each run


class TensorBoardLog:
    """TensorBoard events in the run's folder, where the package is there.

    Args:
        folder: of the run.
        step: where it goes on; what a killed run wrote behind it is dropped.
        options: of the run, the hyper-parameters by which TensorBoard compares runs.
    """

    def __init__(self, folder: Path, step: int, options: Dict[str, Any]):
        self.writer: Any = None
        try:
            from torch.utils.tensorboard import SummaryWriter
            from torch.utils.tensorboard.summary import hparams

            self.writer = SummaryWriter(str(Path(folder) / "tensorboard"), purge_step=step + 1)
            for summary in hparams({k: v for k, v in options.items() if k not in NOT_HYPER}, dict.fromkeys(JUDGED_BY)):
                self.writer.file_writer.add_summary(summary)
        except ImportError:
            print("no TensorBoard here: its events are not written", file=sys.stderr)

    def scalars(self, prefix: str, values: Dict[str, Any], step: int) -> None:
        """The finite numbers among `values`, as prefix/name."""
        for name, value in values.items():
            if self.writer and isinstance(value, (int, float)) and np.isfinite(value):
                self.writer.add_scalar("%s/%s" % (prefix, name), value, step)

    def episode(self, info: Dict[str, Any], step: int) -> None:
        """A training episode: its return, and what each term of the reward had in it."""
        self.scalars("episode", {name: info.get(name) for name in ("return", "length", "time_s")}, step)
        self.scalars("reward", info.get("terms", {}), step)

    def round(self, summary: Dict[str, Any]) -> None:
        """A round of the periodic evaluation."""
        prefix = "default_dwa" if summary["round"] == THETA0 else "held_out"
        names = ("return", "length", "success", "collided", "time_s", "score")
        self.scalars(prefix, {name: summary.get(name) for name in names}, summary["step"])

    def close(self) -> None:
        """Write what is pending."""
        if self.writer:
            self.writer.close()


class ProgressLine:
    """One line that is written over on a terminal, and every half minute a new one elsewhere."""

    def __init__(self) -> None:
        self.terminal = sys.stdout.isatty()
        self.every = 1.0 if self.terminal else 30.0
        self._next = time.monotonic() + 1.0
        self._last: Optional[Any] = None
        self._shown = False

    def due(self) -> bool:
        """Whether it is time for another."""
        return time.monotonic() >= self._next

    def rates(self, now: float, counts: Dict[str, int]) -> Dict[str, float]:
        """How fast the counts grew since the last call [1/s]."""
        before, self._last = self._last or (now, counts), (now, counts)
        seconds = now - before[0]
        return {name: (counts[name] - before[1][name]) / seconds if seconds > 0 else 0.0 for name in counts}

    def show(self, text: str) -> None:
        """Show the line."""
        self._next = time.monotonic() + self.every
        if self.terminal:
            width = os.get_terminal_size().columns - 1 if sys.stdout.isatty() else 200
            print("\r\x1b[K" + text[:width], end="", flush=True)
            self._shown = True
        else:
            print(text, flush=True)

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self.close()
        print(text, flush=True)

    def close(self) -> None:
        """End the line, so that others can print."""
        if self._shown:
            print()
            self._shown = False


def describe(summary: Dict[str, Any]) -> str:
    """A round of the periodic evaluation in one line."""
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
    """H:MM:SS, or ? where the seconds are no finite number."""
    if not 0.0 <= seconds < 1e8:
        return "?" if not seconds < 0.0 else "0:00:00"
    return "%d:%02d:%02d" % (seconds // 3600, seconds // 60 % 60, seconds % 60)


def status(unit: str, done: int, goal: int, values: Dict[str, Any], most: float = float("inf")) -> str:
    """The progress line of a run.

    Args:
        unit: what its length is counted in, transitions or updates.
        done: how many it has made.
        goal: how many it is to make.
        values: of the run, by the names that run.py gives them.
        most: time after which it ends however many it has made [s].
    """
    rate = values[unit + "_per_second"]
    left = (goal - done) / rate if rate > 0 else float("inf")
    return (
        "{done:,} of {goal:,} {unit}  {transitions_per_second:.1f} transitions/s  {updates_per_second:.1f} updates/s  "
        "sigma {sigma:.2f}  return {return:.2f}  length {length:.1f}  success {success:.2f}  contact {collided:.2f}  "
        "Q {q:.2f}  policy age {staleness_mean:.0f} (max {staleness_max})  actors {actors}{more}  {left} left"
    ).format(
        unit=unit,
        done=done,
        goal=goal,
        q=values.get("actor_q", float("nan")),
        more="".join("  %s %d" % (name, values[name]) for name in ("replaced", "refused") if values[name]),
        left=clock(min(left, max(most, 0.0))),
        **values,
    )
