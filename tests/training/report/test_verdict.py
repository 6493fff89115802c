"""The verdict on a policy by made-up results, and reasons of failures."""

import numpy as np
import pytest

from training.report import verdict as judging
from training.report.verdict import mean_scores, paired_trials
from training.trials.trial import Result, Trial

BOTH, THREE = ("dwa", "applr"), ("dwa", "applr", "static")


def trials_of(world, seconds, trial=0):
    """{Trial: Result} of one course; seconds: {method: time [s], or the reason of a failure}."""
    found = {}
    for method, value in seconds.items():
        failed = isinstance(value, str)
        result = Result(success=not failed, timeout=failed, time_s=100.0 if failed else value)
        result = Result(**{**vars(result), "reason": value if failed else "finished"})
        found[Trial(world, method, trial, 1, world, method, "ours")] = result
    return found


def pairs_of(*courses, methods=BOTH):
    found = {}
    for number, values in enumerate(courses):
        found.update(trials_of(f"world{number}", dict(zip(methods, values))))
    return paired_trials(found, methods)


def around(*middles, count=12):
    draws = np.random.default_rng(1).normal(0.0, 1.0, (count, len(middles)))
    return [tuple(map(float, np.array(middles) + draw)) for draw in draws - draws.mean(axis=0)]


@pytest.mark.parametrize(
    ("courses", "methods", "method", "second"),
    [
        (around(30, 20), BOTH, "applr", "The policy pays on mine: it takes 10.0 s less"),
        (around(20, 30), BOTH, "dwa", "does not pay on mine: it takes 10.0 s more"),
        (around(20, 20), BOTH, "dwa", "Whether the policy pays on mine is not clear"),
        (around(30, 25, 15), THREE, "static", "the tuned parameters do"),
        (around(30, 15, 25), THREE, "applr", "The policy pays"),
        ([(20.0 + d, 20.0) for d in (3.0, -1.0, 2.0, 1.0, 4.0, -1.0, 1.0, 1.5)], BOTH, "dwa", "not clear"),  # p = .07
    ],
)
def test_the_verdict_is_two_sentences_and_a_method(courses, methods, method, second):
    found, sentences = judging.verdict(pairs_of(*courses, methods=methods), "mine")
    assert found == method
    courses = len(courses)
    assert sentences[0].startswith(f"Of {courses} courses mine finished {courses} (100 %, ")
    assert second in sentences[1]


def test_where_most_courses_fail_with_all_the_first_sentence_says_so():
    mostly = [("time limit", "time limit")] * 6 + [(20.0, 20.0)] * 5
    _, sentences = judging.verdict(pairs_of(*mostly), "mine")
    assert sentences[0].startswith("mine fails in most courses, whatever sets its parameters: of 11 courses")
    _, sentences = judging.verdict(pairs_of(*mostly, (20.0, 20.0)), "mine")
    assert sentences[0].startswith("Of 12 courses")


def test_a_policy_that_is_faster_but_fails_more_often_does_not_pay():
    courses = [*around(30, 25, count=9), *[(30.0 + i, "time limit") for i in range(7)]]
    method, sentences = judging.verdict(pairs_of(*courses), "mine")
    assert method == "dwa"
    assert "16 (100 %" in sentences[0]
    assert "9 (56 %" in sentences[0]


def test_half_driven_courses_and_further_trials_of_a_world_are_no_pairs_of_their_own():
    found = trials_of("a", {"dwa": 20.0, "applr": 10.0})
    found.update(trials_of("a", {"dwa": 30.0, "applr": 20.0}, trial=1))
    found.update(trials_of("b", {"dwa": 20.0}))
    trials = paired_trials(found, BOTH)
    scores = mean_scores(trials)
    assert (len(trials), scores.dwa.tolist(), scores.applr.tolist()) == (4, [25.0], [15.0])


def test_failures_are_named_by_their_reason():
    control = "planner aborted: Failed to find a valid control. Even after executing recovery behaviors."
    courses = [(control, control), (control, 20.0), ("time limit", 20.0), ("flipped", 20.0), ("flipped", 20.0)]
    assert judging.failures(pairs_of(*courses, ("strange", 20.0))) == [
        f"failed: {control[8:]} (2 with its own parameters, 1 with the policy)",
        "failed: flipped (2 with its own parameters)",
        "failed: time limit (1 with its own parameters)",
    ]
