"""Compares trials in our simulator with default DWA's times in Gazebo, world by world.

`python -m training.compare_gazebo results/trials.csv gazebo_dwa_train.csv`. The second file is a table with the columns
in COLUMNS. It is other people's data and not part of this repository.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from typing import Any, Dict, List, NamedTuple, Optional, Sequence

import numpy as np
from scipy import stats

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import read_bytes
from training.evaluation.store import flag, read_rows
from training.evaluation.trials import COLUMNS as OURS

COLUMNS = ("world", "n", "n_success", "time_mean_succ")
LONGER = 2.0  # [s] that Gazebo's course, to y = 11 m, takes longer than ours, to y = 10 m


class CompareError(ApplrError):
    """One line: what cannot be compared, and why."""


class World(NamedTuple):
    """Trials, successes and the mean time of the successes [s; nan without any] of one world."""

    n: int
    successes: int
    time: float


def ours(path: str, method: str) -> Dict[int, World]:
    """BARN's worlds ("world_N") among the trials of `method` in a trials.csv."""
    found: Dict[int, List[Dict[str, str]]] = {}
    for row in read_rows(path, OURS):
        number = re.match(r"^world_(\d+)$", row["world"])
        if number and row["method"] == method:
            found.setdefault(int(number.group(1)), []).append(row)
    if not found:
        raise CompareError(
            "%s holds no trial of %s in a world_N; give a trials.csv of BARN's own worlds, or --method" % (path, method)
        )
    return {n: _world(rows) for n, rows in found.items()}


def _world(rows: List[Dict[str, str]]) -> World:
    times = [float(row["time_s"]) for row in rows if flag(row["success"])]
    return World(len(rows), len(times), float(np.mean(times)) if times else float("nan"))


def gazebo(path: str, longer: float = LONGER) -> Dict[int, World]:
    """The table of Gazebo's times, `longer` seconds taken off."""
    rows = list(csv.DictReader(read_bytes(path).decode("utf-8", "replace").splitlines()))
    try:
        return {
            int(r["world"]): World(int(r["n"]), int(r["n_success"]), float(r["time_mean_succ"] or "nan") - longer)
            for r in rows
        }
    except (KeyError, TypeError, ValueError) as error:
        raise CompareError(
            "%s is no table of Gazebo's times (%s); it needs the columns %s" % (path, error, ", ".join(COLUMNS))
        ) from None


def compare(a: Dict[int, World], b: Dict[int, World]) -> Dict[str, Any]:
    """Figures of the worlds in both: rates, means over successes, rank correlation of the worlds' means, thirds."""
    common = sorted(set(a) & set(b))
    timed = [n for n in common if np.isfinite(a[n].time) and np.isfinite(b[n].time)]
    if len(timed) < 3:
        raise CompareError("only %d worlds have successes on both sides; at least 3 are needed" % len(timed))
    rank = stats.spearmanr([a[n].time for n in timed], [b[n].time for n in timed])
    found: Dict[str, Any] = {"worlds": len(common), "spearman": float(rank.statistic), "spearman_worlds": len(timed)}
    by_time = sorted(timed, key=lambda n: b[n].time)
    for name, worlds in [("all", common)] + [
        ("third_%d" % (i + 1), list(part)) for i, part in enumerate(np.array_split(by_time, 3))
    ]:
        for side, table in (("ours", a), ("gazebo", b)):
            trials, good = sum(table[n].n for n in worlds), sum(table[n].successes for n in worlds)
            seconds = sum(table[n].successes * table[n].time for n in worlds if table[n].successes)
            found["%s_%s" % (side, name)] = {
                "trials": trials,
                "success": good / trials,
                "time_s": seconds / good if good else float("nan"),
            }
    return found


def lines(found: Dict[str, Any]) -> List[str]:
    """The figures in words."""
    out = ["%d worlds. %-28s %10s %10s %10s" % (found["worlds"], "", "ours", "Gazebo", "")]
    for name, label in (
        ("all", "all"),
        ("third_1", "Gazebo's fastest third"),
        ("third_2", "middle third"),
        ("third_3", "slowest third"),
    ):
        us, them = found["ours_" + name], found["gazebo_" + name]
        out.append(
            "%-38s %9.1f%% %9.1f%% %+7.1f points"
            % (
                "success rate, " + label,
                100 * us["success"],
                100 * them["success"],
                100 * (us["success"] - them["success"]),
            )
        )
        out.append(
            "%-38s %8.2f s %8.2f s %+7.1f %%"
            % ("mean of successes, " + label, us["time_s"], them["time_s"], 100 * (us["time_s"] / them["time_s"] - 1))
        )
    out.append(
        "Spearman correlation of the worlds' mean times over successes (%d worlds): %.3f"
        % (found["spearman_worlds"], found["spearman"])
    )
    return out


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; returns the exit status."""
    return run_main(lambda: run(arguments), "compare_gazebo")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Compare the two tables that the arguments name and print the result."""
    parser = argparse.ArgumentParser(prog="python -m training.compare_gazebo", description=__doc__)
    parser.add_argument("trials", help="The trials.csv of an evaluation in BARN's own worlds.")
    parser.add_argument("gazebo", help="Table of times in Gazebo with the columns %s." % ", ".join(COLUMNS))
    parser.add_argument("--method", default="dwa", help="Method whose trials are compared. Default: %(default)s.")
    parser.add_argument(
        "--longer",
        type=float,
        default=LONGER,
        help="Seconds that the table's course takes longer than ours. Default: %(default)s.",
    )
    parser.add_argument("--json", action="store_true", help="Print the result as one JSON object.")
    options = parser.parse_args(arguments)
    found = compare(ours(options.trials, options.method), gazebo(options.gazebo, options.longer))
    print(json.dumps(found) if options.json else "\n".join(lines(found)))


if __name__ == "__main__":
    sys.exit(main())
