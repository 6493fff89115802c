"""The steps of a search around a policy: pairs of drives, the fit of all pairs so far, and a new centre."""

from __future__ import annotations

import json
import time
from typing import Callable, Iterator, List, NamedTuple, Sequence

import numpy as np

from training.actors.tasks import Trial, TrialResult
from training.common.command_line import ContactSeconds, Seed
from training.common.options import Options, option
from training.evaluation.remembered import RememberedTrials
from training.evaluation.score import CONTACT_SECONDS, trial_seconds
from training.refinement.slopes import Fit, fit

DIGITS = 4  # of coefficients, in what is driven and in what is written
MakeTrial = Callable[[str, str], Trial]  # of a world's specification and a JSON list of coefficients


class SearchOptions(Options):
    """How to search."""

    # fmt: off
    steps: int = option(16, "Number of steps.", ge=1, le=10_000)
    pairs: int = option(500, "Number of pairs of drives in a step.", ge=2, le=10**6)
    sigma: float = option(0.25,
        "Standard deviation of the random numbers, in units of the outputs before tanh.", ge=1e-3, le=3)
    limit: float = option(25.0,
        "Time [s] after which a drive ends and counts as failed; a failure scores as many seconds. A short limit makes "
        "the search faster, and failures, which are rare and mostly chance, drown less.", ge=1, le=100)
    contact_seconds: ContactSeconds = CONTACT_SECONDS
    seed: Seed
    # fmt: on


class Step(NamedTuple):
    """A step's end.

    Attributes:
        number: of the step, from 1.
        results: of its drives.
        score: their mean [s], of shifted policies.
        fit: of all pairs so far.
        centre: (n,) the coefficients that are best by it.
        seconds: since the search began.
    """

    number: int
    results: List[TrialResult]
    score: float
    fit: Fit
    centre: np.ndarray
    seconds: float


def search(
    trials: RememberedTrials, make: MakeTrial, worlds: Sequence[str], groups: np.ndarray, options: SearchOptions
) -> Iterator[Step]:
    """Searches, and yields each step when it is done.

    Args:
        trials: drives them.
        make: makes a trial of a world and coefficients.
        worlds: specifications, one for each pair.
        groups: (n,) the number of the group that each coefficient belongs to, as slopes.fit takes them.
        options: of the search.
    """
    began, rng = time.monotonic(), np.random.default_rng(options.seed)
    size = len(groups)
    centre = np.zeros(size)
    shifts, centres, halves = np.empty((0, size)), np.empty((0, size)), np.empty(0)
    for number in range(options.steps):
        drawn = (options.sigma * rng.standard_normal((options.pairs, size))).round(DIGITS)
        driven = worlds[number * options.pairs :][: options.pairs]
        pairs = [[make(world, _text(centre + sign * e)) for sign in (1, -1)] for world, e in zip(driven, drawn)]
        results = trials.run([trial for pair in pairs for trial in pair])
        scores = np.array([[_score(results[trial], options) for trial in pair] for pair in pairs])
        shifts = np.concatenate([shifts, drawn])
        centres = np.concatenate([centres, np.tile(centre, (len(drawn), 1))])
        halves = np.concatenate([halves, (scores[:, 0] - scores[:, 1]) / 2.0])
        found = fit(shifts, centres, halves, groups)
        centre = towards(found.best, centre, options.sigma * np.sqrt(size)).round(DIGITS)
        seconds = time.monotonic() - began
        yield Step(number + 1, list(results.values()), float(scores.mean()), found, centre, seconds)


def towards(aim: np.ndarray, centre: np.ndarray, reach: float) -> np.ndarray:
    """The aim, or as much of the way from the centre as `reach` is: no farther than where the drives have been."""
    way = aim - centre
    return centre + way * min(1.0, reach / max(float(np.linalg.norm(way)), 1e-9))


def _score(result: TrialResult, options: SearchOptions) -> float:
    return trial_seconds(result.success, result.time_s, result.collided, options.contact_seconds, options.limit)


def _text(coefficients: np.ndarray) -> str:
    return json.dumps([round(float(value), DIGITS) for value in coefficients])
