"""The paper's Tables I to IV from our trials, the paper's numbers beside them. tables_more.py has what goes beyond."""

from __future__ import annotations

import numpy as np

from applr_ros1.policy.decision import PERIOD
from training.report import paper, statistics
from training.report.data import SETS, Results
from training.report.table import NONE, Table, number, share, span


def table_1(results: Results) -> Table:
    """Average traversal times, in seconds and in two-second decisions."""
    rows = []
    for name, worlds, method in results.groups():
        mean, low, high = statistics.mean_time(results, method, worlds)
        success = results.pooled(method, worlds, "success")
        both = results.both(method, worlds)
        base, own = (statistics.mean_counted(results, m, both) for m in (results.baseline, method))
        gain, least, most = statistics.gain(results, method, worlds)
        rival, stated = method != results.baseline, paper.TIME.get((name, method), np.nan)
        rows.append(
            {
                "worlds": name,
                "method": method,
                "time [s]": number(mean),
                "95 % interval": span(low, high),
                "two-second decisions": number(mean / PERIOD),
                "successes": f"{success.sum():.0f} of {len(success)}",
                f"faster than {results.baseline} [s]": number(base - own) if rival else NONE,
                "faster [%]": number(100 * gain, 1) if rival else NONE,
                "95 % interval [%]": span(100 * least, 100 * most, 1) if rival else NONE,
                "paper [decisions]": number(stated),
                "paper [s]": number(stated * PERIOD),
            }
        )
    return Table.of(
        "table_1",
        "Table I: average traversal time",
        rows,
        "Time: mean over the successful trials of all worlds. Faster: over all trials of the worlds that both have "
        "driven, a failed one counting as the limit. Intervals by bootstrap over worlds. In two-second decisions: "
        "seconds / 2.",
        of_paper=(
            paper.UNIT,
            f"The paper's improvement: training {paper.GAIN['Training']}, test {paper.GAIN['Test']}. {paper.GAIN_SLIP}",
        ),
    )


def table_2(results: Results) -> Table:
    """Welch tests per world."""
    base, rows = results.baseline, []
    for name, worlds, method in results.groups(results.rivals):
        verdicts = statistics.welch(results, method, worlds)
        counts = statistics.count(verdicts) + statistics.count(verdicts, corrected=True)
        shares = [share(n, len(verdicts)) for n in counts]
        stated = paper.BETTER.get(name, (NONE, NONE)) if (method, base) == ("applr", "dwa") else (NONE, NONE)
        rows.append(
            {
                "worlds": name,
                "method": method,
                "tested": f"{sum(not np.isnan(v.p) for v in verdicts)} of {len(verdicts)}",
                "method better": shares[0],
                f"{base} better": shares[1],
                "method better (Holm)": shares[2],
                f"{base} better (Holm)": shares[3],
                "paper: applr better": stated[0],
                "paper: dwa better": stated[1],
            }
        )
    return Table.of(
        "table_2",
        "Table II: worlds in which one method is significantly faster",
        rows,
        "Two-sided Welch t-test of the successful trials' times at .05, in each world; a world with "
        "fewer than two successes on a side cannot be tested and counts for neither.",
        "Holm: corrected over all tested worlds of the row. " + paper.CHANCE,
    )


def table_3(results: Results) -> Table:
    """The same by thirds of difficulty."""
    base, thirds, rows = results.baseline, results.thirds(), []
    parts = {part: set(results.of_set(part)) for part in SETS[:2]}
    for third, part in paper.THIRDS:
        worlds = [w for w in thirds[third] if w in parts.get(part, thirds[third])]
        for method in results.rivals if worlds else []:
            both = results.both(method, worlds)
            better, worse = statistics.count(statistics.welch(results, method, both))
            stated = (NONE, NONE)
            if (method, base) == ("applr", "dwa"):
                mark = " (*)" if (third, part) in paper.SWAPPED else ""
                theirs = paper.THIRDS[third, part]
                stated = f"{theirs[0]} %", f"{theirs[1]} %{mark}"
            rows.append(
                {
                    "worlds": f"{third} {part}",
                    "method": method,
                    "n": str(len(both)),
                    "method better": share(better, len(both)),
                    f"{base} better": share(worse, len(both)),
                    f"{base} mean time, all trials [s]": number(results.pooled(base, worlds, "counted").mean()),
                    "paper: applr better": stated[0],
                    "paper: dwa better": stated[1],
                }
            )
    return Table.of(
        "table_3",
        "Table III: the same by difficulty",
        rows,
        f"Thirds of all training and test worlds of this evaluation, by {base}'s mean time over all trials "
        "(a failed one counts as the limit).",
        of_paper=("(*) " + paper.SWAP_SLIP,),
    )


def table_4(results: Results) -> Table:
    """The physical course, with failures named."""
    rows = []
    for method in results.methods:
        cell = results.cells[method].get("physical_course")
        if cell is None:
            continue
        times, failures = cell.times, [r or "failed" for r, good in zip(cell.reason, cell.success) if not good]
        deviation = times.std(ddof=1) if len(times) > 1 else 0.0
        rows.append(
            {
                "method": method,
                "time [s] (mean ± sd)": f"{times.mean():.1f} ± {deviation:.1f}" if len(times) else NONE,
                "successes": f"{cell.success.sum()} of {len(cell.success)}",
                "failures": "; ".join(f"{failures.count(r)}: {r}" for r in dict.fromkeys(failures)) or "none",
                "contacts": f"{cell.collided.sum()} of {len(cell.collided)}",
                "paper [s]": paper.PHYSICAL.get(method, NONE),
            }
        )
    return Table.of(
        "table_4",
        "Table IV: traversal time on the physical course",
        rows,
        "A simulated course of cardboard boxes after the paper's description, not the authors' own; "
        "mean and standard deviation over the successful trials.",
        of_paper=("The paper's numbers are from the real robot, five trials each.",),
    )


PAPER = [table_1, table_2, table_3, table_4]
