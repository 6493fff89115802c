"""The one score of trials, and the periodic evaluation, which drives the trials that evaluate.py drives."""

import math

import numpy as np
import pytest

from training.actors.tasks import TrialResult
from training.baselines.set_search import SearchOptions
from training.evaluation import score, trials
from training.evaluation.periodic import CHOOSING, PeriodicEvaluation


def test_the_score_counts_a_failure_as_the_time_limit():
    """The same score for every caller: periodic evaluation, search and the comparison of simulators."""
    won, lost = TrialResult(True, True, False, 20.0), TrialResult(False, False, False, 7.0)
    assert score.trial_seconds(True, 20.0) == 20.0
    assert score.trial_seconds(False, 7.0, True, 5.0) == 105.0
    found = score.summary([won, lost], contact_seconds=4.0)
    assert (found["score"], found["time_s"], found["success"], found["collided"]) == (62.0, 20.0, 0.5, 0.5)
    assert score.summary([lost], 0.0)["time_s"] is None
    assert score.summary([TrialResult(total_reward=-3.0, decisions=10)], 5.0)["score"] == 3.0  # knows no courses


def test_barn_metric_by_hand():
    success, collided = np.array([True, True, True, False]), np.array([False, False, True, False])
    seconds = np.array([6.0, 30.0, 20.0, 100.0])
    assert score.barn_metric(success, collided, seconds, np.full(4, 7.0)) == pytest.approx([0.5, 3.5 / 28.0, 0.0, 0.0])
    assert score.barn_metric(success, collided, seconds, 7.0, 4.0) == pytest.approx([0.25, 3.5 / 28.0, 0.0, 0.0])


def test_a_search_for_the_metric_prefers_what_arrives():
    slow, fast = TrialResult(True, False, False, 40.0, route_m=7.0), TrialResult(True, True, False, 8.0, route_m=7.0)
    assert SearchOptions(objective="metric").price(slow) < SearchOptions(objective="metric").price(fast) == 0.0
    assert SearchOptions().price(fast) == 13.0 < SearchOptions().price(slow)


def test_periodic_evaluation_drives_what_evaluate_drives(tmp_path):
    """One runner and one plan; but seeds of its own, so that evaluate.py never judges on trials that chose."""
    worlds = [("generated:8", "generated:8")]
    periodic = PeriodicEvaluation(tmp_path, worlds, 1, 100, 3, 0.0)
    (trial,) = periodic.begin(-1, 0, 0)
    (other,) = trials.plan(worlds, [("dwa", "dwa")], 1, CHOOSING + 3, traces=0)
    assert trial == other
    assert trial.seed not in {t.seed for seed in range(200) for t in trials.plan(worlds, [("dwa", "dwa")], 20, seed)}
    answer = trials.TrialRunner("kinematic").run(trial)
    faster = trials.TrialRunner("kinematic", period=1.0).run(trial).result  # a training's own decision period
    assert faster.decisions == math.ceil(faster.time_s)
    assert periodic.add(answer)["score"] == answer.result.time_s < 100.0
