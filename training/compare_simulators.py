"""Whether the kinematic simulator ranks parameters and worlds as pybullet does:
`python -m training.compare_simulators`.

Drives 50 worlds x 5 parameter sets in both (evaluate.py's trials, same seeds; continues where it was stopped) and
writes one table: traversal times' ratio and correlation, agreement of failures, beside pybullet's agreement with
itself on other seeds. A single trial is chaotic: that second column is the best that any simulator could reach.
"""
from __future__ import annotations

import argparse
import os
import sys
from typing import Dict, List, Sequence, Tuple

import numpy as np
from scipy import stats

from applr_ros1.policy.parameter_space import SPACE
from training import evaluate
from training.storage import write_bytes
from training.trial_store import TRIALS, read_rows
from training.trials import COLUMNS

SETS = {        # what differs from theta_0
    "default": {},
    "brisk": {"max_vel_x": 1.0, "vx_samples": 12, "vtheta_samples": 40, "inflation_radius": 0.2},
    "fast": {"max_vel_x": 2.0, "vx_samples": 12, "vtheta_samples": 40, "occdist_scale": 0.05, "inflation_radius": 0.1},
    "nimble": {"max_vel_x": 0.8, "max_vel_theta": 3.14, "vtheta_samples": 40, "pdist_scale": 1.2},
    "careful": {"max_vel_x": 0.4, "max_vel_theta": 1.0, "occdist_scale": 0.3, "gdist_scale": 1.5},
}
LIMIT = 100.0       # [s] what a failure counts as

Cell = Tuple[str, str]      # world, method


class Set:
    """A method for evaluate.py: one of SETS, throughout."""

    def __init__(self, name: str):
        self.theta_ = SPACE.from_dict(SETS[name])

    def theta(self, context):
        return self.theta_


def read(folder: str) -> Dict[Cell, np.ndarray]:
    """{(world, set): (trials, 3) success, seconds (LIMIT for a failure), collided}."""
    found: Dict[Cell, List[Tuple[float, float, float]]] = {}
    for row in read_rows(os.path.join(folder, TRIALS), COLUMNS):
        success = row[4] == "True"
        found.setdefault((row[0], row[1]), []).append(
            (success, float(row[7]) if success else LIMIT, row[5] == "True"))
    return {cell: np.array(trials, dtype=float) for cell, trials in found.items()}


def agreement(a: Dict[Cell, np.ndarray], b: Dict[Cell, np.ndarray]) -> Dict[str, float]:
    """Figures over the cells that both hold. Times are means per cell; those of successes where a ratio is taken."""
    cells = sorted(set(a) & set(b))
    all_a = np.array([a[c][:, 1].mean() for c in cells])
    all_b = np.array([b[c][:, 1].mean() for c in cells])
    both = [c for c in cells if a[c][:, 0].any() and b[c][:, 0].any()]
    good_a = np.array([a[c][a[c][:, 0] > 0, 1].mean() for c in both])
    good_b = np.array([b[c][b[c][:, 0] > 0, 1].mean() for c in both])
    pairs = [(x, y) for c in cells for x, y in zip(a[c][:, 0], b[c][:, 0])]
    return {"cells": len(cells), "ratio": float(np.sum(good_b) / np.sum(good_a)),
            "pearson": float(stats.pearsonr(good_a, good_b)[0]),
            "spearman": float(stats.spearmanr(good_a, good_b)[0]),
            "spearman_with_failures": float(stats.spearmanr(all_a, all_b)[0]),
            "same_outcome": float(np.mean([x == y for x, y in pairs])),
            "success_a": float(np.mean([a[c][:, 0].mean() for c in cells])),
            "success_b": float(np.mean([b[c][:, 0].mean() for c in cells])),
            "contact_a": float(np.mean([a[c][:, 2].mean() for c in cells])),
            "contact_b": float(np.mean([b[c][:, 2].mean() for c in cells]))}


def halves(a: Dict[Cell, np.ndarray]):
    """The same simulator against itself: trials of even and of odd number."""
    return {c: t[0::2] for c, t in a.items()}, {c: t[1::2] for c, t in a.items()}


def table(pybullet: Dict[Cell, np.ndarray], kinematic: Dict[Cell, np.ndarray]) -> str:
    """The comparison as Markdown: overall, then per parameter set."""
    columns = [("kinematic against pybullet", agreement(pybullet, kinematic))]
    if min(len(trials) for trials in pybullet.values()) > 1:
        columns.append(("pybullet against itself (half the trials each)", agreement(*halves(pybullet))))
    names = {"cells": "worlds x sets", "ratio": "mean time of successes, ratio",
             "pearson": "correlation of mean times", "spearman": "rank correlation of mean times",
             "spearman_with_failures": "rank correlation, failures as %g s" % LIMIT,
             "same_outcome": "same outcome, trial by trial", "success_a": "success rate, first",
             "success_b": "success rate, second", "contact_a": "trials with contact, first",
             "contact_b": "trials with contact, second"}
    lines = ["| | %s |" % " | ".join(title for title, _ in columns), "|---|%s" % ("---|" * len(columns))]
    for key, name in names.items():
        lines.append("| %s | %s |" % (name, " | ".join("%.4g" % figures[key] for _, figures in columns)))
    lines += ["", "| set | success pybullet / kinematic | mean time of successes [s] | ratio | rank correlation |",
              "|---|---|---|---|---|"]
    for name in SETS:
        a = {c: t for c, t in pybullet.items() if c[1] == name}
        b = {c: t for c, t in kinematic.items() if c[1] == name}
        if len(set(a) & set(b)) > 2:
            figures = agreement(a, b)
            times = [np.concatenate(list(side.values())) for side in (a, b)]
            means = [side[side[:, 0] > 0, 1].mean() for side in times]
            lines.append("| %s | %.3f / %.3f | %.1f / %.1f | %.3f | %.2f |" % (
                name, figures["success_a"], figures["success_b"], means[0], means[1], figures["ratio"],
                figures["spearman"]))
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] = None) -> int:
    parser = argparse.ArgumentParser(prog="compare_simulators", description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", default="generated:test", help="as for evaluate.py (default: generated:test)")
    parser.add_argument("--trials", type=int, default=2, help="of each set in each world and simulator (default: 2)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="results/simulators", help="folder for trials and comparison.md")
    options = parser.parse_args(arguments)
    methods = ",".join("%s=training.compare_simulators:Set:%s" % (name, name) for name in SETS)
    for simulator in ("pybullet", "kinematic"):
        status = evaluate.main(["--worlds", options.worlds, "--methods", methods, "--trials", str(options.trials),
                                "--simulator", simulator, "--workers", str(options.workers), "--no-report",
                                "--seed", str(options.seed), "--traces", "0",
                                "--out", os.path.join(options.out, simulator)])
        if status:
            return status
    text = table(*(read(os.path.join(options.out, simulator)) for simulator in ("pybullet", "kinematic")))
    write_bytes(os.path.join(options.out, "comparison.md"), text.encode())
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
