"""Compares trials in our simulator with default DWA's times in Gazebo, world by world.

`python -m training.compare_gazebo results/trials.csv gazebo_dwa_train.csv`. The second file is a table with the columns
in COLUMNS. It is other people's data and not part of this repository. Nothing is driven here: which robot drove is a
matter of the two tables.
"""

from __future__ import annotations

import csv
import json
import re
import sys
from typing import Dict, List, NamedTuple, Optional, Sequence

import numpy as np
from scipy import stats

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import read_bytes
from training.command_line import Parser, number
from training.evaluation.store import flag, read_rows
from training.evaluation.trials import COLUMNS as OURS
from training.evaluation.trials import WEIGHTS_COLUMN

COLUMNS = ("world", "n", "n_success", "time_mean_succ")
GAZEBO, MIXTURE = "Gazebo", "mixture"
ROWS = {
    "worlds": ("worlds", "%d"),
    "trials": ("trials", "%d"),
    "success": ("success rate", "%.3f"),
    "mean_s": ("mean of the worlds' mean times [s]", "%.1f"),
    "q10_s": ("10 % of the worlds take at most [s]", "%.1f"),
    "q25_s": ("25 %", "%.1f"),
    "q50_s": ("50 %", "%.1f"),
    "q75_s": ("75 %", "%.1f"),
    "q90_s": ("90 %", "%.1f"),
    "fastest_s": ("mean of Gazebo's fastest third [s]", "%.1f"),
    "middle_s": ("middle third", "%.1f"),
    "slowest_s": ("slowest third", "%.1f"),
    "spearman": ("rank correlation with Gazebo (Spearman)", "%.2f"),
    "distance_s": ("mean distance from Gazebo's time in the same world [s]", "%.1f"),
    "differing": ("worlds in which the kinds of weights differ by more than 15 s", "%d"),
    "differing_s": ("mean there [s]", "%.1f"),
}  # of the table: figure -> label, format
DIFFERING = 15.0  # [s]
LONGER = 2.0  # [s] that Gazebo's course, to y = 11 m, takes longer than ours, to y = 10 m


class CompareError(ApplrError):
    """One line: what cannot be compared, and why."""


class WorldTimes(NamedTuple):
    """Trials, successes and the mean time of the successes [s; nan without any] of one world."""

    n: int
    successes: int
    time: float


def ours(path: str, method: str) -> Dict[str, Dict[int, WorldTimes]]:
    """BARN's worlds ("world_N") among the trials of `method` in a trials.csv, by kind of distance weights.

    "ours" stands for the one kind of a file that does not name any; several kinds are followed by MIXTURE, the trials
    of all of them.
    """
    kinds: Dict[str, Dict[int, List[Dict[str, str]]]] = {}
    for row in read_rows(path, OURS):
        number = re.match(r"^world_(\d+)$", row["world"])
        if number and row["method"] == method:
            for kind in (row[WEIGHTS_COLUMN], MIXTURE) if WEIGHTS_COLUMN in row else ("ours",):
                kinds.setdefault(kind, {}).setdefault(int(number.group(1)), []).append(row)
    if not kinds:
        raise CompareError(
            "%s holds no trial of %s in a world_N; give a trials.csv of BARN's own worlds, or --method" % (path, method)
        )
    ordered = sorted(kinds, key=lambda kind: kind == MIXTURE)
    return {kind: {n: _world(rows) for n, rows in kinds[kind].items()} for kind in ordered}


def _world(rows: List[Dict[str, str]]) -> WorldTimes:
    times = [float(row["time_s"]) for row in rows if flag(row["success"])]
    return WorldTimes(len(rows), len(times), float(np.mean(times)) if times else float("nan"))


def gazebo(path: str, longer: float = LONGER) -> Dict[int, WorldTimes]:
    """The table of Gazebo's times, `longer` seconds taken off."""
    rows = list(csv.DictReader(read_bytes(path).decode("utf-8", "replace").splitlines()))
    try:
        return {
            int(r["world"]): WorldTimes(int(r["n"]), int(r["n_success"]), float(r["time_mean_succ"] or "nan") - longer)
            for r in rows
        }
    except (KeyError, TypeError, ValueError) as error:
        raise CompareError(
            "%s is no table of Gazebo's times (%s); it needs the columns %s" % (path, error, ", ".join(COLUMNS))
        ) from None


def compare(sides: Dict[str, Dict[int, WorldTimes]], table: Dict[int, WorldTimes]) -> Dict[str, Dict[str, float]]:
    """Figures (ROWS) of Gazebo's table and of each side, over the worlds that all of them hold.

    Times are means of each world's successes, over the worlds with a success everywhere; the thirds are Gazebo's.
    """
    everything = {GAZEBO: table, **sides}
    common = sorted(set.intersection(*(set(worlds) for worlds in everything.values())))
    timed = [n for n in common if all(np.isfinite(worlds[n].time) for worlds in everything.values())]
    if len(timed) < 3:
        raise CompareError("only %d worlds have successes on all sides; at least 3 are needed" % len(timed))
    thirds = np.array_split(sorted(timed, key=lambda n: table[n].time), 3)
    kinds = [worlds for kind, worlds in sides.items() if kind != MIXTURE]
    differing = [n for n in timed if max(k[n].time for k in kinds) - min(k[n].time for k in kinds) > DIFFERING]
    theirs = np.array([table[n].time for n in timed])
    found = {}
    for name, worlds in everything.items():
        times = np.array([worlds[n].time for n in timed])
        trials = sum(worlds[n].n for n in common)
        quantiles = np.quantile(times, [0.1, 0.25, 0.5, 0.75, 0.9])
        values = [len(common), trials, sum(worlds[n].successes for n in common) / trials, times.mean(), *quantiles]
        values += [np.mean([worlds[n].time for n in third]) for third in thirds]
        values += [stats.spearmanr(times, theirs).statistic, np.abs(times - theirs).mean(), len(differing)]
        values += [np.mean([worlds[n].time for n in differing]) if differing else np.nan]
        found[name] = {row: float(value) for row, value in zip(ROWS, values)}
    return found


def markdown(found: Dict[str, Dict[str, float]]) -> str:
    """The figures as a table, a column per side."""
    lines = ["| | %s |" % " | ".join(found), "|---|%s" % ("---:|" * len(found))]
    for row, (label, form) in ROWS.items():
        if any(np.isnan(side[row]) for side in found.values()):
            continue
        lines.append("| %s | %s |" % (label, " | ".join(form % side[row] for side in found.values())))
    return "\n".join(lines)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; returns the exit status."""
    return run_main(lambda: run(arguments), "compare_gazebo")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Compare the two tables that the arguments name and print the result."""
    parser = Parser("python -m training.compare_gazebo", description=__doc__)
    parser.add_argument("trials", help="The trials.csv of an evaluation in BARN's own worlds.")
    parser.add_argument("gazebo", help="Table of times in Gazebo with the columns %s." % ", ".join(COLUMNS))
    parser.add_argument("--method", default="dwa", help="Method whose trials are compared. Default: %(default)s.")
    parser.add_argument(
        "--longer",
        type=number(-1e3, 1e3),
        default=LONGER,
        help="Seconds that the table's course takes longer than ours. Default: %(default)s.",
    )
    parser.add_argument("--json", action="store_true", help="Print the result as one JSON object.")
    options = parser.parse_args(arguments)
    found = compare(ours(options.trials, options.method), gazebo(options.gazebo, options.longer))
    print(json.dumps(found) if options.json else markdown(found))


if __name__ == "__main__":
    sys.exit(main())
