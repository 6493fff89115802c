"""What an evaluation says in three sentences: who is faster, who fails, and what the sample can show. page.py asks."""

from __future__ import annotations

import math
from typing import List

import pandas as pd

from training.evaluation.score import FAILURE_SECONDS
from training.report import statistics
from training.report.data import Results


def summary(results: Results) -> List[str]:
    """Three sentences over the test worlds where there are at least two of them, else over all worlds.

    Times are compared as in Table I: over all trials of the worlds that both methods have driven, with intervals by
    bootstrap over worlds.
    """
    base = results.baseline
    test = results.both(results.of_set("Test"), base)
    worlds, kind = (test, "test worlds") if len(test) > 1 else (results.worlds, "worlds")
    where = f"{len(worlds)} {kind}" if len(worlds) > 1 else worlds[0]
    found = {method: results.compare(method, base, worlds) for method in results.rivals}
    pace = [one.sentence(method, base) for method, one in found.items() if one.worlds]
    if not pace:
        pace = [f"{base} took {results.of(base, worlds).counted.mean():.1f} s on average, and no other to compare"]
    driven = [trials for trials in (results.of(method, worlds) for method in results.methods) if len(trials)]
    return [
        f"In {where}, a failed trial counting as {FAILURE_SECONDS:g} s, {'; '.join(pace)}.",
        f"Of all trials {'; '.join(_ends(trials) for trials in driven)}.",
        _sample(driven, len(worlds), [(one.gain.high - one.gain.low) / 2 for one in found.values()]),
    ]


def _ends(trials: pd.DataFrame) -> str:
    """How many trials of a method failed, and how many had a contact."""
    failed, touched = (~trials.success).sum(), trials.collided.sum()
    ends = f"fails in {failed or 'none'} of {len(trials)} and touches something in {touched or 'none'}"
    return f"{trials.method.iloc[0]} {ends}"


def _sample(driven: List[pd.DataFrame], worlds: int, halves: List[float]) -> str:
    """What differences and rates of failures the sample leaves open."""
    if worlds < 2:
        return "One world is no sample of worlds: this holds for it alone."
    first = f"The sample is {worlds} worlds, since trials of one world resemble each other"
    halves = [half for half in halves if math.isfinite(half)]
    if halves:
        first += f"; it leaves differences of time uncertain by about ± {100 * max(halves):.0f} %"
    clean = [statistics.rate(~trials.success, trials.world).high for trials in driven if trials.success.all()]
    if clean:
        first += f", and a method without a failure may still fail in up to {100 * max(clean):.1f} % of such trials"
    return f"{first}; it says nothing about worlds of another kind or about a real robot."
