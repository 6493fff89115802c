"""Tests of the verdict on a policy with synthetic results."""

import numpy as np
import pytest

from training.evaluate import verdict as judging
from training.evaluate.score import mean_scores
from training.evaluate.trial import Result, Trial
from training.evaluate.verdict import paired_trials

BOTH = ("dwa", "applr")
THREE = ("dwa", "applr", "static")


def trials_of(world, seconds, trial=0):
    """Return {Trial: Result} of one course from {method: time [s], or the reason of a failure}."""
    results = {}
    for method, time_or_reason in seconds.items():
        if isinstance(time_or_reason, str):
            result = Result(timeout=True, time_s=100.0, reason=time_or_reason)
        else:
            result = Result(success=True, time_s=time_or_reason, reason="finished")
        results[Trial(world, method, trial, 1, world, method)] = result
    return results


def pairs_of(*courses, methods=BOTH):
    """Return the paired trials of courses, each a time [s] or reason per method."""
    results = {}
    for number, times_or_reasons in enumerate(courses):
        seconds = dict(zip(methods, times_or_reasons))
        results.update(trials_of(f"world{number}", seconds))
    return paired_trials(results, methods)


def verdict_on(*courses):
    """Return the verdict on applr against dwa on courses, each (time or reason of both)."""
    return judging.verdict(pairs_of(*courses))


def comparison_of(judgement):
    """Return the line of a verdict that compares the first method with the baseline."""
    return judgement.lines[1]


def around(*means, count=12):
    """Return courses with random times [s] whose means are exactly these."""
    noise = np.random.default_rng(1).normal(0.0, 1.0, (count, len(means)))
    noise -= noise.mean(axis=0)
    times = np.array(means) + noise
    return list(map(tuple, times.tolist()))


def rows_of(judged):
    """Return the words of each row of a verdict's table: method, trials, arrivals, ..."""
    _, *rows = judged.lines[0].splitlines()
    return list(map(str.split, rows))


# Courses with a difference of p = .1
UNCLEAR = [
    (23.0, 20.0),
    (19.0, 20.0),
    (22.0, 20.0),
    (21.0, 20.0),
    (24.0, 20.0),
    (19.0, 20.0),
    (21.0, 20.0),
    (21.5, 20.0),
]
ALL_ARRIVE = "12 of 12 arrive (dwa: 12)"
IN_BOTH = "where both arrive (12 drives)"


@pytest.mark.parametrize(
    ("courses", "methods", "method", "lines"),
    [
        (
            around(30, 20),
            BOTH,
            "applr",
            [f"applr better: yes, {ALL_ARRIVE}; 20.0 s instead of 30.0 s {IN_BOTH}"],
        ),
        (
            around(20, 30),
            BOTH,
            "dwa",
            [f"applr better: no, {ALL_ARRIVE}; 30.0 s instead of 20.0 s {IN_BOTH}"],
        ),
        (around(20, 20), BOTH, "dwa", ["applr better: no, "]),
        (around(30, 25, 15), THREE, "static", ["applr better: yes, ", "static better: yes, "]),
        (around(30, 15, 25), THREE, "applr", ["applr better: yes, ", "static better: yes, "]),
        (UNCLEAR, BOTH, "dwa", ["applr better: no, "]),
    ],
)
def test_a_verdict_has_a_method_a_table_and_a_line_per_comparison(courses, methods, method, lines):
    judgement = judging.verdict(pairs_of(*courses, methods=methods))
    assert judgement.method == method
    _, *comparisons = judgement.lines[: len(methods)]
    assert len(comparisons) == len(lines)
    for line, beginning in zip(comparisons, lines):
        assert line.startswith(beginning)
    # All drives arrive, and none has a contact.
    course_count = str(len(courses))
    for row, method_name in zip(rows_of(judgement), methods):
        assert row[:4] == [method_name, course_count, course_count, "0"]


def test_a_difference_that_is_not_significant_says_that_the_courses_are_too_few():
    line = comparison_of(verdict_on(*UNCLEAR))
    assert line.endswith("; p = 0.1: too few courses to tell")
    line = comparison_of(verdict_on((30.0, 20.0)))
    assert line.endswith("; too few courses to tell")


def test_arrivals_come_first_and_times_are_of_the_drives_in_which_both_arrive():
    """It arrives on harder courses, which take longer: a mean over all drives is slower."""
    easy_courses = [(30.0 + index, 20.0 + index) for index in range(6)]
    hard_courses = [("time limit", 60.0 + index) for index in range(10)]

    judgement = verdict_on(*easy_courses, *hard_courses)

    assert judgement.method == "applr"
    arrivals, times_of_both, p_value = comparison_of(judgement).split("; ")
    assert arrivals == "applr better: yes, 16 of 16 arrive (dwa: 6)"
    assert times_of_both == "22.5 s instead of 32.5 s where both arrive (6 drives)"
    assert p_value.startswith("p = ")
    dwa_row, applr_row = rows_of(judgement)
    assert dwa_row[4] == "32.5"
    assert applr_row[4] == "22.5"


def test_without_a_course_on_which_both_arrive_no_times_are_compared():
    courses = [("time limit", 20.0 + index) for index in range(6)]
    courses += [(20.0, "contact"), (21.0, "contact")]
    line = comparison_of(verdict_on(*courses))
    assert line.startswith("applr better: no, 6 of 8 arrive (dwa: 2); p = ")


def test_the_courses_that_still_fail_are_named_by_reason():
    judgement = verdict_on(
        (30.0, 20.0),
        (30.0, "contact"),
        ("time limit", "time limit"),
        (30.0, "contact"),
    )
    failures = "applr fails on 3 of 4 courses: contact (world1, world3); time limit (world2)"
    assert judgement.lines[-1] == failures

    judgement = verdict_on((30.0, 20.0), ("contact", 20.0))
    assert judgement.lines[-1] == "applr fails on none of 2 courses"


def test_the_lines_say_what_the_test_counts():
    judgement = judging.verdict(pairs_of(*around(30, 20)), "a failure costs a year")
    _, _, test_line, _ = judgement.lines
    assert "p: paired sign-flip permutation test of the cost; a failure costs a year" in test_line


@pytest.mark.parametrize(
    ("course", "flaw"),
    [
        # 20 courses: the worst tenth is two, of which one takes 45 s.
        ((30.0, 45.0), "its worst tenth is worse"),
        # The fall costs no more than dwa's failure.
        (
            ("time limit", "flipped"),
            "it falls over in 1 drive: lower base.max_speed in robot.yaml to what the base bears",
        ),
    ],
)
def test_a_policy_that_is_better_on_average_and_has_a_flaw_is_not_better(course, flaw):
    judgement = verdict_on(*around(30, 20, count=19), course)

    assert judgement.method == "dwa"
    line = comparison_of(judgement)
    assert line.startswith("applr better: no, ")
    assert line.endswith(f"; {flaw}")


def test_a_policy_that_falls_over_where_the_baseline_does_may_be_better():
    judgement = verdict_on(*around(30, 20, count=19), ("flipped", "flipped"))
    assert judgement.method == "applr"


def test_half_driven_courses_are_left_out_and_further_trials_of_a_world_are_averaged():
    results = {
        **trials_of("a", {"dwa": 20.0, "applr": 10.0}),
        **trials_of("a", {"dwa": 30.0, "applr": 20.0}, trial=1),
        # World b lacks a drive of applr.
        **trials_of("b", {"dwa": 20.0}),
    }
    trials = paired_trials(results, BOTH)
    scores = mean_scores(trials)
    assert len(trials) == 4
    assert scores.dwa.tolist() == [25.0]
    assert scores.applr.tolist() == [15.0]
