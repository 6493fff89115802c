"""Shows whether the kinematic simulator ranks parameter sets and worlds as pybullet does.

`python -m training.compare_simulators --worlds generated:train --count 50 --sets 5` drives the same worlds, parameter
sets and seeds in both, as evaluate.py does; a comparison that was stopped continues with the same command. It writes
comparison.csv, a row per trial, and comparison.md with the correlation and ratio of traversal times, the agreement of
failures, and contacts. Single trials are chaotic. With --trials 2 or more, pybullet's agreement with itself on other
seeds stands beside it, which is the best that any simulator could reach.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import sys
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy import stats

import worlds as worlds_package
from applr_ros1.common.errors import run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.policy.methods import Method
from applr_ros1.robots import JACKAL, Robot
from training.command_line import (
    Parser,
    add_robot,
    add_seed,
    add_trials,
    add_weights,
    add_workers,
    add_worlds,
    simulator,
    whole,
)
from training.evaluation.run import EvaluationOptions, evaluate
from training.evaluation.score import FAILURE_SECONDS, trial_seconds
from training.evaluation.store import TRIALS, flag, read_rows
from training.evaluation.trials import COLUMNS, KEY, evenly_spaced

KNOWN = ("dwa", "fast_dwa")  # the first sets, theta_0 and, for the Jackal, Fast-DWA; those behind them are drawn

Cell = Tuple[str, str]  # world, set


class Drawn(Method):
    """A method for evaluate.py: set number N, uniform over the robot's ranges, the same in every run."""

    def __init__(self, number: str):
        self._number = int(number)

    @property
    def values(self) -> np.ndarray:
        """The set (n,)."""
        random = np.random.default_rng([0x5E75, self._number])
        return self.space.to_theta(random.uniform(-1.0, 1.0, len(self.space)))

    def theta(self, context: Any) -> np.ndarray:
        """The set, whatever the context."""
        return self.values

    def describe(self) -> Dict[str, Any]:
        """For evaluation.json."""
        return {"parameters": self.space.as_dict(self.values)}


def set_names(count: int, robot: Robot = JACKAL) -> List[str]:
    """What the sets are called: theta_0, for the Jackal Fast-DWA, and then the drawn ones."""
    known = KNOWN if robot.name == JACKAL.name else KNOWN[:1]
    return [known[n] if n < len(known) else "random_%d" % (n - len(known) + 1) for n in range(count)]


# -- what was driven -------------------------------------------------------------------------------------------------
def read(folder: str) -> Dict[Cell, np.ndarray]:
    """{(world, set): (trials, 3) success, seconds (as they are ranked), contact}, in the order of the trials."""
    found: Dict[Cell, List[Tuple[float, float, float]]] = {}
    for row in read_rows(os.path.join(folder, TRIALS), COLUMNS):
        success = flag(row["success"])
        trial = (success, trial_seconds(success, float(row["time_s"])), flag(row["collided"]))
        found.setdefault((row["world"], row["method"]), []).append(trial)
    return {cell: np.array(trials, dtype=float) for cell, trials in found.items()}


def agreement(a: Dict[Cell, np.ndarray], b: Dict[Cell, np.ndarray]) -> Dict[str, float]:
    """Figures over the cells that both hold.

    Times are means over a cell's successes, of the cells that have one in
    both; NaN where there are too few. Outcomes are compared trial by trial.
    """
    cells = sorted(set(a) & set(b))
    both = [c for c in cells if a[c][:, 0].any() and b[c][:, 0].any()]
    good_a, good_b = ([side[c][side[c][:, 0] > 0, 1].mean() for c in both] for side in (a, b))
    pairs = np.array([(x, y) for c in cells for x, y in zip(a[c][:, 0], b[c][:, 0])]).reshape(-1, 2) > 0

    def rate(side, column):
        return float(np.mean([side[c][:, column].mean() for c in cells])) if cells else np.nan

    return {
        "cells": len(cells),
        "compared": len(both),
        "pearson": _correlation(stats.pearsonr, good_a, good_b),
        "spearman": _correlation(stats.spearmanr, good_a, good_b),
        "spearman_all": _correlation(stats.spearmanr, *([side[c][:, 1].mean() for c in cells] for side in (a, b))),
        "ratio": float(np.sum(good_b) / np.sum(good_a)) if both else np.nan,
        "trials": len(pairs),
        "same_outcome": float(np.mean(pairs[:, 0] == pairs[:, 1])) if len(pairs) else np.nan,
        "both_failed": int((~pairs).all(1).sum()),
        "only_first_failed": int((~pairs[:, 0] & pairs[:, 1]).sum()),
        "only_second_failed": int((pairs[:, 0] & ~pairs[:, 1]).sum()),
        "success_first": rate(a, 0),
        "success_second": rate(b, 0),
        "contact_first": rate(a, 2),
        "contact_second": rate(b, 2),
    }


def _correlation(measure, x, y) -> float:
    return float(measure(x, y)[0]) if len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0 else np.nan


def halves(a: Dict[Cell, np.ndarray]) -> Tuple[Dict[Cell, np.ndarray], Dict[Cell, np.ndarray]]:
    """A simulator against itself: trials of even and of odd number."""
    return {c: t[0::2] for c, t in a.items()}, {c: t[1::2] for c, t in a.items()}


# -- what is written -------------------------------------------------------------------------------------------------
ROWS = {
    "cells": "worlds x sets",
    "compared": "of these with a success in both",
    "pearson": "correlation of their times (Pearson)",
    "spearman": "rank correlation of their times (Spearman)",
    "spearman_all": "rank correlation of all, failures as %g s" % FAILURE_SECONDS,
    "ratio": "ratio of mean times, second / first",
    "trials": "trials of each",
    "same_outcome": "same outcome, trial by trial",
    "both_failed": "failed in both",
    "only_first_failed": "failed in the first only",
    "only_second_failed": "failed in the second only",
    "success_first": "success rate, first",
    "success_second": "success rate, second",
    "contact_first": "trials with contact, first",
    "contact_second": "trials with contact, second",
}
SETS_HEAD = (
    "set",
    "success",
    "with contact",
    "mean time of successes [s]",
    "ratio",
    "Pearson",
    "Spearman",
    "same outcome",
)


def markdown(first: str, second: str, a: Dict[Cell, np.ndarray], b: Dict[Cell, np.ndarray]) -> str:
    """All, then set by set, then each cell's time side by side."""
    columns = [("%s, then %s" % (first, second), agreement(a, b))]
    if min(len(trials) for trials in a.values()) > 1:
        columns.append(("%s against itself, half the trials each" % first, agreement(*halves(a))))
    lines = _table(
        [""] + [title for title, _ in columns],
        [[name] + [_said(figures[key]) for _, figures in columns] for key, name in ROWS.items()],
    )
    sets = list(dict.fromkeys(c[1] for c in a))
    rows = []
    for name in sets:
        side_a, side_b = ({c: t for c, t in side.items() if c[1] == name} for side in (a, b))
        f = agreement(side_a, side_b)
        rows.append(
            [
                name,
                "%s / %s" % (_said(f["success_first"]), _said(f["success_second"])),
                "%s / %s" % (_said(f["contact_first"]), _said(f["contact_second"])),
                "%s / %s" % (_mean(side_a), _mean(side_b)),
                _said(f["ratio"]),
                _said(f["pearson"]),
                _said(f["spearman"]),
                _said(f["same_outcome"]),
            ]
        )
    lines += ["", "Per set, %s / %s:" % (first, second), ""] + _table(SETS_HEAD, rows)
    cells = list(dict.fromkeys(c[0] for c in a))
    lines += ["", "Mean time of successes [s], %s / %s (– where no trial succeeded):" % (first, second), ""]
    lines += _table(
        ["world"] + sets,
        [
            [world]
            + [
                "%s / %s" % tuple(_mean({c: side[c] for c in [(world, name)] if c in side}) for side in (a, b))
                for name in sets
            ]
            for world in cells
        ],
    )
    return "\n".join(lines) + "\n"


def side_by_side(first: str, second: str, folders: Sequence[str]) -> str:
    """CSV: a row per trial that both drove."""
    a, b = (
        {tuple(row[name] for name in KEY): row for row in read_rows(os.path.join(f, TRIALS), COLUMNS)} for f in folders
    )
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    parts = ("success", "collided", "time_s")
    writer.writerow(
        ["world", "set", "trial", "seed"] + ["%s_%s" % (part, name) for name in (first, second) for part in parts]
    )
    for key in a:
        if key in b:
            writer.writerow(list(key) + [side[key][part] for side in (a, b) for part in parts])
    return out.getvalue()


def _table(head, rows) -> List[str]:
    return ["| %s |" % " | ".join(row) for row in [head, ["---"] * len(head)] + rows]


def _said(value) -> str:
    return "–" if np.isnan(value) else "%d" % value if isinstance(value, int) else "%.3f" % value


def _mean(side: Dict[Cell, np.ndarray]) -> str:
    times = np.concatenate([t[t[:, 0] > 0, 1] for t in side.values()]) if side else np.zeros(0)
    return "%.1f" % times.mean() if len(times) else "–"


# -- the command -----------------------------------------------------------------------------------------------------
def parse(arguments: Optional[Sequence[str]] = None) -> argparse.Namespace:
    """Checked options. Raises UsageError."""
    p = Parser("compare_simulators", description=__doc__)
    add_worlds(p, "generated:train")
    add_robot(p)
    p.add_argument(
        "--count",
        type=whole(0, 100_000),
        default=50,
        help="Number of these worlds that are used, evenly spread over them; 0 uses all. Default: %(default)s.",
    )
    p.add_argument(
        "--sets",
        type=whole(1, 1000),
        default=5,
        help=(
            "Number of parameter sets: theta_0, Fast-DWA (Jackal), and random ones that are the same in every run. "
            "Default: %(default)s."
        ),
    )
    add_trials(p, 1, "of each set in each world and simulator")
    add_workers(p, EvaluationOptions.workers)
    add_seed(p)
    p.add_argument("--out", default="results/simulators", help="Folder for the comparison. Default: %(default)s.")
    p.add_argument(
        "--simulators",
        type=_simulators,
        default="pybullet,kinematic",
        help="The two simulators to compare, separated by a comma. Default: %(default)s.",
    )
    add_weights(p)
    p.add_argument("--runner", default=EvaluationOptions.runner, help=argparse.SUPPRESS)  # tests give a toy
    return p.parse_args(arguments)


def _simulators(text: str) -> List[str]:
    names = text.split(",")
    if len(names) != 2:
        raise argparse.ArgumentTypeError("%r: give two names, like pybullet,kinematic" % text)
    return [simulator(name) for name in names]


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0; 1 and one line on stderr for a mistake; 130 after Ctrl-C."""
    return run_main(lambda: run(parse(arguments)), "compare_simulators")


def run(options: argparse.Namespace) -> None:
    """Evaluates in both simulators, and writes and prints the comparison."""
    specs = [spec for part in options.worlds.split(",") for spec in worlds_package.specs(part.strip())]
    chosen = [
        "%s=training.compare_simulators:Drawn:%s" % (n, n[7:]) if n not in KNOWN else n
        for n in set_names(options.sets, options.robot)
    ]
    first, second = options.simulators
    folders = [os.path.join(options.out, first), os.path.join(options.out, second + "-2" * (first == second))]
    for name, folder in zip((first, second), folders):
        evaluate(
            EvaluationOptions(
                worlds=",".join(evenly_spaced(specs, options.count)),
                robot=options.robot,
                methods=",".join(chosen),
                trials=options.trials,
                simulator=name,
                workers=options.workers,
                out=folder,
                seed=options.seed,
                traces=0,
                weights=(options.weights,),
                runner=options.runner,
            )
        )
    a, b = (os.path.basename(folder) for folder in folders)
    text = "Distance weights: %s.\n\n" % options.weights + markdown(a, b, *(read(folder) for folder in folders))
    write_bytes(os.path.join(options.out, "comparison.csv"), side_by_side(a, b, folders).encode())
    write_bytes(os.path.join(options.out, "comparison.md"), text.encode())
    print(text)


if __name__ == "__main__":
    sys.exit(main())
