"""What an evaluation says in three sentences: who is faster, who fails, and what the sample can show. page.py asks."""

from __future__ import annotations

import math
from typing import List

from training.evaluation.score import FAILURE_SECONDS
from training.report import statistics
from training.report.data import Results


def summary(results: Results) -> List[str]:
    """Three sentences over the test worlds where there are at least two of them, else over all worlds.

    Times are compared as in Table I: over all trials of the worlds that both methods have driven, with intervals by
    bootstrap over worlds.
    """
    base = results.baseline
    test = results.both(base, results.of_set("Test"), base)
    worlds, kind = (test, "test worlds") if len(test) > 1 else (results.worlds, "worlds")
    methods = results.methods
    where = f"{len(worlds)} {kind}" if len(worlds) > 1 else worlds[0]
    rivals = [m for m in methods if m != base and results.both(m, worlds)]
    gains = [100 * value for m in rivals for value in statistics.gain(results, m, worlds)]
    pace = [_pace(m, base, *gains[3 * n : 3 * n + 3]) for n, m in enumerate(rivals)]
    if not rivals:
        pace = [
            f"{base} takes {statistics.mean_counted(results, base, worlds):.1f} s on average, and no other to compare"
        ]
    ends = [_ends(results, m, worlds) for m in methods if results.both(m, worlds, m)]
    return [
        f"In {where}, a failed trial counting as {FAILURE_SECONDS:g} s, {'; '.join(pace)}.",
        f"Of all trials {'; '.join(ends)}.",
        _sample(results, methods, worlds, [(high - low) / 2 for low, high in zip(gains[1::3], gains[2::3])]),
    ]


def _pace(method: str, base: str, gain: float, low: float, high: float) -> str:
    """How much less time than the baseline a method takes [%], with the interval."""
    said = f"{method} takes {abs(gain):.1f} % {'less' if gain >= 0.0 else 'more'} time than {base}"
    if not math.isfinite(low):
        return said
    if low <= 0.0 <= high:
        ends = f"95 % interval {-high:+.1f} to {-low:+.1f} %"
        return f"{method} cannot be told from {base} in time ({-gain:+.1f} %, {ends})"
    near, far = sorted((abs(low), abs(high)))
    return f"{said} (95 % interval {near:.1f} to {far:.1f} %)"


def _ends(results: Results, method: str, worlds: List[str]) -> str:
    """How many trials of a method failed, and how many had a contact."""
    success, collided = (results.pooled(method, worlds, field) for field in ("success", "collided"))
    failed, touched = int((~success.astype(bool)).sum()), int(collided.sum())
    return f"{method} fails in {failed or 'none'} of {len(success)} and touches something in {touched or 'none'}"


def _sample(results: Results, methods: List[str], worlds: List[str], halves: List[float]) -> str:
    """What differences and rates of failures the sample leaves open."""
    if len(worlds) < 2:
        return "One world is no sample of worlds: this holds for it alone."
    first = f"The sample is {len(worlds)} worlds, since trials of one world resemble each other"
    halves = [half for half in halves if math.isfinite(half)]
    if halves:
        first += f"; it leaves differences of time uncertain by about ± {max(halves):.0f} %"
    flags = [[~results.cells[m][w].success for w in results.both(m, worlds, m)] for m in methods]
    clean = [statistics.rate(f)[2] for f in flags if f and not any(part.any() for part in f)]
    if clean:
        first += f", and a method without a failure may still fail in up to {100 * max(clean):.1f} % of such trials"
    return f"{first}; it says nothing about worlds of another kind or about a real robot."
