"""Whether the policy pays on a robot: a verdict from pairs of trials, and why drives failed. try_robot.py prints it.

A drive counts as its time, as 100 s where it failed, and as 5 s more where the robot touched something
(evaluation/score.py). Methods are compared by the paired t-test of the races (score.clearly_worse), with the world as
the unit, after the numbers of pairs in LOOKS and at the end: at LEVEL per look and side, a difference where there is
none is found in at most one of twenty runs. A run that is continued looks once more.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping, Sequence, Tuple

import numpy as np

from training.actors.tasks import Trial, TrialResult
from training.evaluation.score import CONTACT_SECONDS, FAILURE_SECONDS, clearly_worse, trial_seconds
from training.report.statistics import over_worlds, rate, ratio

OWN, POLICY, SET = "dwa", "applr", "static"
WORDS = {OWN: "its own parameters", POLICY: "the policy", SET: "the best single set"}
LOOKS = (8, 16)  # numbers of pairs after which it may end; there is a last look when all is driven or the time is spent
LEVEL = 0.05 / 2 / (len(LOOKS) + 1)

# what a trial's reason begins with, and what to change; the first that fits counts
REMEDIES = (
    (
        "aborted: Failed to find a valid control",
        "the local planner refused every velocity: raise acc_lim_x and acc_lim_theta, lower min_vel_x and "
        "min_vel_theta, raise the numbers of samples, or lower footprint_padding",
    ),
    (
        "aborted: Failed to find a valid plan",
        "the global planner found no way: check footprint, footprint_padding and inflation_radius against the width of "
        "the gaps that the robot is to pass",
    ),
    (
        "aborted: Robot is oscillating",
        "it moved too little for too long: raise oscillation_timeout, lower oscillation_distance and min_vel_x",
    ),
    (
        "time limit",
        "it did not arrive within 100 s: raise max_vel_x as far as the base allows, and sim_time where it hesitates",
    ),
    ("flipped", "it fell over: lower max_vel_x, max_vel_theta and acc_lim_x, or check body.com in robot.yaml"),
)


@dataclass(frozen=True)
class Verdict:
    """What is to be said at the end.

    Attributes:
        method: the one to drive with.
        pays: whether that is the policy, which then is clearly better than the robot's own parameters.
        sentences: arrivals and times; whether the policy pays; what to do next.
    """

    method: str
    pays: bool
    sentences: Tuple[str, str, str]


class Pairs:
    """Trials of some methods in the same courses with the same seeds.

    Args:
        results: of the trials; those of a world, number and method whose rivals are missing are left out.
        methods: the robot's own parameters first.
    """

    def __init__(self, results: Mapping[Trial, TrialResult], methods: Sequence[str]):
        self.methods = list(methods)
        found: Dict[Tuple[str, int], Dict[str, TrialResult]] = {}
        for trial, result in results.items():
            found.setdefault((trial.world, trial.trial), {})[trial.method] = result
        whole = {key: row for key, row in found.items() if len(row) == len(self.methods)}
        self.worlds = list(dict.fromkeys(world for world, _ in whole))
        self._rows = {w: [row for (world, _), row in whole.items() if world == w] for w in self.worlds}
        self.count = len(whole)

    def of(self, method: str) -> List[List[TrialResult]]:
        """A method's trials, a list for each world."""
        return [[row[method] for row in self._rows[world]] for world in self.worlds]

    def scores(self, method: str) -> np.ndarray:
        """A method's mean score in each world (n,) [s]."""
        return np.array(
            [
                np.mean([trial_seconds(r.success, r.time_s, r.collided, CONTACT_SECONDS) for r in trials])
                for trials in self.of(method)
            ]
        )

    def worse(self, method: str, other: str) -> bool:
        """Whether a method is clearly worse than another."""
        return clearly_worse(self.scores(method), self.scores(other), LEVEL)

    def decided(self) -> bool:
        """Whether one method is clearly better than each of the others."""
        return any(all(self.worse(other, best) for other in self.methods if other != best) for best in self.methods)


def verdict(pairs: Pairs, robot: str, folder: str, used_up: bool) -> Verdict:
    """The verdict on a robot.

    Args:
        pairs: of at least one course.
        robot: its name.
        folder: of its description.
        used_up: whether no courses are left, so that more time would not help.
    """
    better = [method for method in pairs.methods[1:] if pairs.worse(OWN, method)]
    best = min(better, key=lambda method: pairs.scores(method).mean(), default=OWN)
    driven = f"Of {pairs.count} courses {robot} finished " + ", ".join(
        f"{_arrivals(pairs.of(method))} with {WORDS[method]}" for method in pairs.methods
    )
    saved = pairs.scores(OWN) - pairs.scores(POLICY)
    mean, low, high = over_worlds([saved, np.ones(len(saved))], ratio)
    how = f"it takes {abs(mean):.1f} s {'less' if mean > 0 else 'more'} per course than {WORDS[OWN]}"
    if np.isfinite(low):
        how += f" (95 % interval of what it saves: {low:.1f} to {high:.1f} s)"
    how += f", where a failed drive counts as {FAILURE_SECONDS:g} s and a contact as {CONTACT_SECONDS:g} s more"
    train = f"python -m training.train --robot {folder} --recipe applr --init-from applr"
    if best == POLICY:
        judged = f"The policy pays on {robot}: {how}."
        advice = f"Drive with it, and let it learn this robot ({train} ...), which may save more."
    elif best == SET:
        judged = f"The policy does not pay on {robot}, the best single set does: with the policy {how}."
        advice = f"Load {folder}/static.yaml after your own parameters, or train a policy of its own ({train} ...)."
    elif pairs.worse(POLICY, OWN):
        judged = f"The policy does not pay on {robot}: {how}."
        advice = f"Keep your parameters, or train a policy of its own ({train} ...) and try again."
    else:
        judged = f"Whether the policy pays on {robot} is not clear: {how}."
        advice = (
            f"Keep your parameters, or train a policy of its own ({train} ...): no courses are left to drive."
            if used_up
            else "Keep your parameters for now, and give the same command more --minutes: it continues."
        )
    return Verdict(best, best == POLICY, (driven + ".", judged, advice))


def _arrivals(worlds: Sequence[Sequence[TrialResult]]) -> str:
    flags = [np.array([r.success for r in trials]) for trials in worlds]
    share, low, high = rate(flags)
    text = f"{sum(int(f.sum()) for f in flags)} ({100 * share:.0f} %, {100 * low:.0f} to {100 * high:.0f} %)"
    times = [np.array([r.time_s for r in trials if r.success]) for trials in worlds]
    mean, low, high = over_worlds([np.array([t.sum() for t in times]), np.array([float(len(t)) for t in times])], ratio)
    text += f" in {mean:.1f} s" if np.isfinite(mean) else ""
    return text + (f" ({low:.1f} to {high:.1f} s)" if np.isfinite(low) else "")


def failures(pairs: Pairs) -> List[str]:
    """A line for each of the three commonest reasons of failures: which, how often by method, and what to change."""
    found: Counter[str] = Counter()
    by: Dict[str, Counter[str]] = {}
    for method in pairs.methods:
        for result in (r for trials in pairs.of(method) for r in trials if not r.success):
            why = reason(result)
            found[why] += 1
            by.setdefault(why, Counter())[method] += 1
    lines = []
    for why, _ in found.most_common(3):
        who = ", ".join(f"{count} with {WORDS[method]}" for method, count in by[why].items())
        what = next((text for start, text in REMEDIES if why.startswith(start)), "")
        lines.append(f"failed: {why} ({who})" + (f": {what}" if what else ""))
    return lines


def reason(result: TrialResult) -> str:
    """Why a trial failed: "aborted: ..." where the planner gave up, whatever time the trial stands for."""
    prefix = "planner aborted: "
    return "aborted: " + result.reason[len(prefix) :] if result.reason.startswith(prefix) else result.reason or "failed"


def picture(pairs: Pairs, robot: str, path: Path) -> None:
    """Draws each course's score with the robot's own parameters against that with the others, into a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    own = pairs.scores(OWN)
    most = 1.05 * max(float(pairs.scores(method).max()) for method in pairs.methods)
    axes.plot([0, most], [0, most], color="gray", linewidth=1)
    for method, mark in zip(pairs.methods[1:], "ox"):
        axes.plot(own, pairs.scores(method), mark, alpha=0.7, label=WORDS[method])
    axes.set(xlim=(0, most), ylim=(0, most), aspect="equal", title=f"{robot}: a point per world, faster below the line")
    axes.set(xlabel=f"with {WORDS[OWN]} [s], a failure as {FAILURE_SECONDS:g}", ylabel="with the other [s]")
    axes.legend(loc="upper left")
    figure.savefig(path, dpi=100)
