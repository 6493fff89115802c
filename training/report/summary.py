"""What an evaluation says in three sentences: who arrives, who is faster, what the sample can show. page.py asks."""

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
        pace = [f"there is no other method to compare {base} with"]
    driven = [trials for trials in (results.of(method, worlds) for method in results.methods) if len(trials)]
    return [
        f"In {where} {'; '.join(_ends(trials) for trials in driven)}.",
        f"Where a failed drive counts as {FAILURE_SECONDS:g} s, {'; '.join(pace)}.",
        _sample(driven, len(worlds), [(one.gain.high - one.gain.low) / 2 for one in found.values()]),
    ]


def _ends(trials: pd.DataFrame) -> str:
    """How many trials of a method arrived, in what time, and how many had a contact."""
    good, touched = trials[trials.success], trials.collided.sum()
    how = f"arrived in {len(good) or 'none'} of {len(trials)} drives"
    how += f", after {good.time_s.mean():.1f} s on average" if len(good) else ""
    return f"{trials.method.iloc[0]} {how}, and touched something in {touched or 'none'}"


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
