"""Tests of the verdict on a policy with synthetic results."""

import numpy as np
import pytest

from training.evaluate import verdict as judging
from training.evaluate.trial import Result, Trial
from training.evaluate.verdict import mean_scores, paired_trials

BOTH, THREE = ("dwa", "applr"), ("dwa", "applr", "static")


def trials_of(world, seconds, trial=0):
    """Return {Trial: Result} of one course from {method: time [s], or the reason of a failure}."""
    results = {}
    for method, value in seconds.items():
        failed = isinstance(value, str)
        result = Result(success=not failed, timeout=failed, time_s=100.0 if failed else value)
        result = Result(**{**vars(result), "reason": value if failed else "finished"})
        results[Trial(world, method, trial, 1, world, method)] = result
    return results


def pairs_of(*courses, methods=BOTH):
    results = {}
    for number, values in enumerate(courses):
        results.update(trials_of(f"world{number}", dict(zip(methods, values))))
    return paired_trials(results, methods)


def around(*middles, count=12):
    draws = np.random.default_rng(1).normal(0.0, 1.0, (count, len(middles)))
    return [tuple(map(float, np.array(middles) + draw)) for draw in draws - draws.mean(axis=0)]


@pytest.mark.parametrize(
    ("courses", "methods", "method", "last"),
    [
        (around(30, 20), BOTH, "applr", "applr better: yes, 10.0 s less per course"),
        (around(20, 30), BOTH, "dwa", "applr better: no, 10.0 s more per course"),
        (around(20, 20), BOTH, "dwa", "applr better: no, "),
        (around(30, 25, 15), THREE, "static", "static better: yes, 15.0 s less per course"),
        (around(30, 15, 25), THREE, "applr", "static better: yes, 5.0 s less per course"),
        # a difference with p = .07
        ([(20.0 + d, 20.0) for d in (3.0, -1.0, 2.0, 1.0, 4.0, -1.0, 1.0, 1.5)], BOTH, "dwa", "applr better: no, "),
    ],
)
def test_the_verdict_is_a_method_a_table_and_a_line_for_each_comparison(courses, methods, method, last):
    best, lines = judging.verdict(pairs_of(*courses, methods=methods))
    assert best == method
    assert len(lines) == len(methods)
    assert lines[-1].startswith(last)
    rows = [row.split() for row in lines[0].splitlines()[1:]]
    assert [row[:4] for row in rows] == [[name, *[str(len(courses))] * 2, "0"] for name in methods]


def test_a_policy_that_is_better_on_average_and_creeps_in_the_worst_tenth_is_not_better():
    courses = [*around(30, 20, count=19), (30.0, 45.0)]
    method, (table, line) = judging.verdict(pairs_of(*courses))
    assert method == "dwa"
    assert line.startswith("applr better: yes, ")
    assert line.endswith(", but its worst tenth is worse")
    worst = [float(row.split()[-1]) for row in table.splitlines()[1:]]
    assert worst[1] > worst[0]


def test_a_policy_that_is_faster_but_fails_more_often_is_not_better():
    courses = [*around(30, 25, count=9), *[(30.0 + i, "time limit") for i in range(7)]]
    method, (table, line) = judging.verdict(pairs_of(*courses))
    assert method == "dwa"
    assert [row.split()[1:3] for row in table.splitlines()[1:]] == [["16", "16"], ["16", "9"]]
    assert line.startswith("applr better: no, ")


def test_half_driven_courses_are_left_out_and_further_trials_of_a_world_are_averaged():
    results = trials_of("a", {"dwa": 20.0, "applr": 10.0})
    results.update(trials_of("a", {"dwa": 30.0, "applr": 20.0}, trial=1))
    results.update(trials_of("b", {"dwa": 20.0}))
    trials = paired_trials(results, BOTH)
    scores = mean_scores(trials)
    assert (len(trials), scores.dwa.tolist(), scores.applr.tolist()) == (4, [25.0], [15.0])
