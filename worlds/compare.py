"""Whether the generator makes BARN's kind of worlds: `python -m worlds.compare [FOLDER] [--csv FILE]`.

Puts fill and difficulty of the 300 built-in worlds beside BARN's published figures, or beside a folder of BARN's own
files.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import sys
from typing import Dict, List, Optional

import numpy as np

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError, run_main

from . import barn_grid, builtin, metrics
from .loading import folder_files, load
from .world import World, WorldError

QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)
FILL = "fill"
MEASURES = (FILL,) + metrics.NAMES
# Published for BARN: medians of its 300 worlds; for the fill the 5 %, 50 % and 95 % quantiles
BARN = {
    FILL: {0.05: 0.11, 0.50: 0.18, 0.95: 0.28},
    "closest_obstacle": {0.50: 2.13},
    "visibility": {0.50: 5.28},
    "dispersion": {0.50: 4.51},
    "dimension": {0.50: 3.22},
    "tortuosity": {0.50: 1.168},
}
CSV_COLUMNS = {
    "closest_obstacle": "dist_closest_obstacle_cells",
    "visibility": "avg_visibility_cells",
    "dispersion": "dispersion",
    "dimension": "char_dimension_cells",
    "tortuosity": "tortuosity",
}


def measure(worlds: List[World]) -> Dict[str, np.ndarray]:
    """Each of MEASURES for each world: name -> (n,)."""
    rows = [metrics.difficulty(w) for w in worlds]
    table = {name: np.array([row[name] for row in rows]) for name in metrics.NAMES}
    table[FILL] = np.array([metrics.fill_share(barn_grid.fill_of(w.cylinders)) for w in worlds])
    return table


def table(ours: Dict[str, np.ndarray], theirs: Optional[Dict[str, np.ndarray]] = None) -> List[str]:
    """Lines: quantiles of ours above BARN's, with the Kolmogorov-Smirnov statistic where BARN's worlds are at hand."""
    lines = [
        "%-17s %-11s %s   %s"
        % (
            "measure",
            "worlds",
            " ".join("%6.0f %%" % (100 * q) for q in QUANTILES),
            "KS statistic, p" if theirs else "",
        )
    ]
    for name in MEASURES:
        lines.append("%-17s %-11s %s" % (name, "built-in", _row(ours[name])))
        if theirs is None:
            known = BARN[name]
            lines.append(
                "%-17s %-11s %s"
                % ("", "BARN", " ".join("%8.3f" % known[q] if q in known else "       -" for q in QUANTILES))
            )
            continue
        from scipy.stats import ks_2samp

        test = ks_2samp(ours[name], theirs[name])
        lines.append(
            "%-17s %-11s %s   %.3f, %.2f" % ("", "BARN files", _row(theirs[name]), test.statistic, test.pvalue)
        )
    return lines


def _row(values: np.ndarray) -> str:
    return " ".join("%8.3f" % v for v in np.quantile(values, QUANTILES))


MAX_TABLE = 2**24  # bytes


def csv_agreement(worlds: List[World], file: str) -> List[str]:
    """Lines: how far our metrics of BARN's files are from those in a table of BARN's own (columns of CSV_COLUMNS)."""
    try:
        text = files.read_bytes(file, MAX_TABLE).decode("utf-8", "replace")
        rows = {int(row["world"]): row for row in csv.DictReader(text.splitlines())}
        pairs = [(w, rows[int(re.findall(r"\d+$", w.name)[0])]) for w in worlds]
        theirs = {name: np.array([float(row[column]) for _, row in pairs]) for name, column in CSV_COLUMNS.items()}
    except ApplrError:
        raise
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise WorldError(
            "%s lacks %s; it needs a row for each world and the columns world, %s"
            % (file, error, ", ".join(CSV_COLUMNS.values()))
        ) from None
    ours = measure([w for w, _ in pairs])
    return [
        "%-17s largest difference from %s over %d worlds: %.1e"
        % (name, os.path.basename(file), len(pairs), np.abs(ours[name] - theirs[name]).max())
        for name in CSV_COLUMNS
    ]


def main() -> int:
    """Exit status 1 and one line where a file cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m worlds.compare", description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", nargs="?", help="Folder with BARN's .world files and, below it, path_files/.")
    parser.add_argument(
        "--csv",
        help="Table of BARN's metrics with the columns world, %s, to check ours against on the folder's files."
        % ", ".join(CSV_COLUMNS.values()),
    )
    return run_main(lambda: _print_comparison(parser.parse_args()), "compare")


def _print_comparison(arguments: argparse.Namespace) -> None:
    if arguments.csv and not arguments.folder:
        raise WorldError("--csv %s needs the folder of the same worlds; give it too" % arguments.csv)
    barn = [load(f) for f in folder_files(arguments.folder)] if arguments.folder else []
    built_in = [builtin.world(n) for n in sorted(builtin.fields())]
    print("\n".join(table(measure(built_in), measure(barn) if barn else None)))
    if arguments.csv:
        print("\n".join(csv_agreement(barn, arguments.csv)))


if __name__ == "__main__":
    sys.exit(main())
