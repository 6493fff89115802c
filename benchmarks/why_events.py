"""Table of what `./applr why` says of planted causes: `python -m benchmarks.why_events`.

Each cause is planted in each situation that must not change the answer, with several seeds. A row
of docs/results/events.csv counts the answers that name the cause, that say as much as can be known,
and that are wrong.
"""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

from tests.support.planted_drives import CAUSES, SITUATIONS, planted, said_of

TABLE = Path(__file__).parents[1] / "docs" / "results" / "events.csv"
SEEDS = range(5)


def main() -> None:
    """Write the table."""
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["situation", "cause", "right", "honest", "wrong", "said"])
        for situation in SITUATIONS:
            for cause in CAUSES:
                counts: Counter[str] = Counter()
                for seed in SEEDS:
                    said = said_of(planted(cause, situation, seed))
                    counts[said.verdict(cause, situation)] += 1
                verdicts = [counts[verdict] for verdict in ("right", "honest", "wrong")]
                table.writerow([situation, cause, *verdicts, said.reason])


if __name__ == "__main__":
    main()
