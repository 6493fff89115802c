"""Tests of the score of trials, and of the periodic evaluation, which drives the same trials as
evaluate.py.
"""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy

from applr_ros1.policy.actor import forward, save
from applr_ros1.policy.dimensionless import SIZE, DimensionlessEncoding
from applr_ros1.robots import JACKAL, load
from applr_ros1.robots.learned import OUTPUTS
from tests.support.runs import SETTINGS
from training.env.env import ApplrEnv
from training.env.settings import TrialSettings
from training.evaluate import runner, score
from training.evaluate.periodic import CHOOSING, PeriodicEvaluation
from training.evaluate.stored import Results
from training.evaluate.table import TrialTable
from training.evaluate.trial import POLICY, Result, Trial, plan_trials
from training.evaluate.verdict import paired_trials
from training.train.td3.td3 import TD3, TD3Options
from training.workers.collect import policy_layers
from training.workers.pool import Pool

ARRIVED = Result(success=True, time_s=20.0)
ARRIVED_WITH_A_CONTACT = Result(success=True, collided=True, time_s=30.0)
FAILED_EARLY = Result(success=False, time_s=7.0)
FAILED_WITH_A_CONTACT = Result(success=False, collided=True, time_s=3.0)


@pytest.mark.parametrize(
    ("result", "seconds"),
    [
        (ARRIVED, 20.0),
        (ARRIVED_WITH_A_CONTACT, 100.0),
        (FAILED_EARLY, 100.0),
        (FAILED_WITH_A_CONTACT, 100.0),
    ],
)
def test_the_score_is_the_time_and_100_s_after_any_failure_or_contact(result, seconds):
    assert score.seconds(result) == seconds


def test_the_summary_of_trials_has_means_and_the_time_of_successes():
    summary = score.summary([ARRIVED, ARRIVED_WITH_A_CONTACT, FAILED_EARLY, FAILED_WITH_A_CONTACT])
    assert summary["score"] == 80.0
    assert summary["time_s"] == 25.0
    assert summary["success"] == summary["collided"] == 0.5
    assert score.summary([FAILED_EARLY])["time_s"] is None

    # 7 m take 3.5 s at 2 m/s, a quarter of the time of this drive.
    arrived = Result(True, time_s=14.0, route_m=7.0, decisions=7, total_reward=5.0)
    failed = Result(False, time_s=4.0, route_m=7.0, decisions=2, total_reward=-20.0)
    summary = score.summary([arrived, failed])
    assert summary["metric"] == 0.5 * 0.25
    assert summary["length"] == 4.5
    assert summary["return"] == -7.5


def test_reports_verdicts_and_periodic_evaluations_have_the_same_score(tmp_path):
    """The selection of a policy and the report on it would otherwise disagree about which policy is
    better.
    """
    results = [ARRIVED, ARRIVED_WITH_A_CONTACT, FAILED_EARLY]
    plan = plan_trials([("generated:1", "generated:1")], [("dwa", "dwa")], len(results), seed=0)
    driven = dict(zip(plan, results))
    # Of 20 s, and 100 s for a contact and for a failure
    expected_score = pytest.approx(220.0 / 3.0)

    settings = {
        **SETTINGS,
        "worlds": ["generated:1"],
        "world_specs": ["generated:1"],
    }
    table = TrialTable(tmp_path, settings)
    for trial, result in driven.items():
        table.add(trial, result)
    reported_scores = score.mean_scores(Results(tmp_path).trials)

    assert reported_scores.loc["generated:1", "dwa"] == expected_score
    assert paired_trials(driven, ["dwa"]).score.mean() == expected_score
    assert score.summary(results)["score"] == expected_score


def test_barn_metric_by_hand():
    success = np.array([True, True, True, False])
    collided = np.array([False, False, True, False])
    seconds = np.array([6.0, 30.0, 20.0, 100.0])
    # 7 m take 3.5 s at the Jackal's largest speed of 2 m/s. Times count as at least 2 and at most
    # 8 of these.
    route_lengths = np.full(4, 7.0)
    metric = score.barn_metric(success, collided, seconds, route_lengths)
    assert metric == pytest.approx([0.5, 3.5 / 28.0, 0.0, 0.0])


def test_the_cost_of_an_aim_by_hand():
    # 8 m take 4 s at the Jackal's largest speed of 2 m/s.
    one_width = JACKAL.body.size[1]
    result = Result(True, time_s=12.0, route_m=8.0, mean_clearance_m=one_width)
    result = replace(result, mean_jerk=2.0, mean_turn=3.0)
    baseline = score.Baseline(pace=2.5, jerk=1.0, turn=2.0)
    aim = score.Aim(failure=10.0, slower=2.0, near=0.5, jerk=0.1, turn=0.2)

    # Nearness, jerk and turning, in optimal times
    others = 0.5 * (score.CLEAR - 1.0) + 0.1 * 2.0 + 0.2 * 1.5
    # Three optimal times are half of one slower than the baseline, and cost another one.
    cost = aim.cost(result, JACKAL, baseline)
    assert cost == pytest.approx(4.0 * (3.0 + 1.0 + others))
    # To be faster than the baseline gains nothing more.
    cost = aim.cost(replace(result, time_s=8.0), JACKAL, baseline)
    assert cost == pytest.approx(4.0 * (2.0 + others))
    cost = aim.cost(replace(result, collided=True), JACKAL, baseline)
    assert cost == pytest.approx(4.0 * (10.0 + others))

    # The page says which of these count.
    assert "nearness" in aim.rule
    assert "jerk and turning" in aim.rule
    assert score.Aim(failure=10.0).rule == (
        "a failure or contact costs 10 times the course's shortest time"
    )


def test_a_baseline_has_the_means_of_the_drives_that_arrive():
    # 8 m and 10 m take 4 s and 5 s at the Jackal's largest speed of 2 m/s.
    slow = Result(True, time_s=12.0, route_m=8.0, mean_jerk=2.0, mean_turn=1.5)
    fast = Result(True, time_s=10.0, route_m=10.0, mean_jerk=4.0, mean_turn=3.5)
    failed = Result(False, time_s=3.0, route_m=8.0, mean_jerk=90.0, mean_turn=90.0)
    baseline = score.Baseline.of([slow, failed, fast], JACKAL)
    # Three optimal times, and two
    assert baseline == score.Baseline(pace=2.5, jerk=3.0, turn=2.5)
    # Costs are divided by jerk and turning.
    assert score.Baseline.of([replace(slow, mean_turn=0.0)], JACKAL).turn == 1.0
    # Nothing is slower than a baseline that never arrives.
    assert score.Baseline.of([failed], JACKAL) == score.Baseline(math.inf, 1.0, 1.0)


@pytest.mark.heavy
def test_periodic_evaluation_drives_the_trials_of_evaluate(tmp_path):
    """Runner and plan are the same. The seeds differ, so that no trial is used for both selection
    and evaluation.
    """
    worlds = [("generated:8", "generated:8")]
    methods = [("dwa", "dwa")]
    (trial,) = plan_trials(worlds, methods, trials=1, seed=CHOOSING + 3, traces=0)
    for seed in range(200):
        for evaluated in plan_trials(worlds, methods, trials=20, seed=seed):
            assert evaluated.seed != trial.seed
    result = runner.TrialRunner(TrialSettings()).run(trial)

    # The decision period of a training.
    often_decided = runner.TrialRunner(TrialSettings(period=1.0)).run(trial)
    assert often_decided.decisions == math.ceil(often_decided.time_s)

    def run(task, weights):
        assert task == trial
        return result, b""

    periodic = PeriodicEvaluation(tmp_path, worlds, 100, 3, has_start=False)
    line = periodic.drive(0, Pool(0), run, b"", step=0, version=0)
    assert line["score"] == pytest.approx(result.time_s, abs=1e-4)
    assert line["score"] < 100.0


def random_policy():
    """Return the weights of a policy that has learnt nothing yet."""
    options = TD3Options(net_arch=[32])
    return TD3(SIZE, len(OUTPUTS), options, seed=5).actor_weights()


@pytest.mark.heavy
def test_a_policy_is_evaluated_as_its_file_drives(tmp_path):
    """The periodic evaluation gives the same result as evaluate.py with the file, to the last
    digit, on any robot.
    """
    policy_file = tmp_path / "a.safetensors"
    save(policy_file, random_policy(), encoding=DimensionlessEncoding(JACKAL, 0.5))
    options = {
        "observation": "dimensionless",
        "reward": {"exact_time": True},
        "time_limit": 5.0,
    }
    for robot, world in (("jackal", "generated:8"), ("husky", "generated:9")):
        settings = TrialSettings(robot=robot, period=0.5, **options)
        (task,) = plan_trials([(world, world)], [("policy", POLICY)], 1, 0)
        result, _ = runner.run(settings, task, policy_file.read_bytes())
        # As evaluate.py drives it
        file_task = replace(task, method_spec=str(policy_file))
        assert runner.TrialRunner(settings).run(file_task) == result
        assert result.decisions == 10
    # Without a period, the settings have the paper's 2 s.
    with pytest.raises(ValueError, match="decision period"):
        runner.TrialRunner(TrialSettings(**options))


def test_the_environments_rewards_add_up_to_the_evaluations_total(monkeypatch):
    """With the same decisions on the same course, the environment's rewards add up to the trial's
    total.
    """
    options = {
        "robot": "husky",
        "observation": "dimensionless",
        "reward": {"exact_time": True},
        "period": 1.0,
        "time_limit": 6.0,
    }
    policy = safetensors.numpy.save(random_policy())

    # As the evaluation drives it
    world = "generated:8"
    (task,) = plan_trials([(world, world)], [("policy", POLICY)], 1, 0, traces=0)
    driver = runner.TrialRunner(TrialSettings(**options))
    total_reward = driver.run(task, policy).total_reward

    # In the environment, whose drawn seed is replaced by that of the trial
    env = ApplrEnv(worlds=world, **options)
    begin = env.begin
    monkeypatch.setattr(
        env, "begin", lambda world, drawn_seed, rules: begin(world, task.seed, rules)
    )
    observation, _ = env.reset()
    rewards = []
    for _ in range(6):
        action = np.tanh(forward(policy_layers(policy), observation))
        observation, reward, *_ = env.step(action)
        rewards.append(reward)
    env.close()
    assert sum(rewards) == pytest.approx(total_reward, abs=1e-9)


def test_switching_is_the_mean_change_of_all_parameters_over_all_decisions():
    driver = runner.TrialRunner(TrialSettings(period=0.5, time_limit=1.0))
    space = driver.space
    speed = space.names.index("max_vel_x")
    theta = space.theta0.copy()
    # A quarter of the range is half an action unit.
    theta[speed] += 0.25 * (space.high[speed] - space.low[speed])
    task = Trial("generated:7", "m", 0, 1, "generated:7", "", theta=tuple(theta.tolist()))

    result = driver.run(task)

    # The first of two decisions changes one of the parameters, the second none.
    assert result.decisions == 2
    assert result.switching == pytest.approx(0.5 / len(space.names) / 2)


def test_a_trial_is_remembered_for_the_robot_as_its_files_describe_it(tmp_path):
    """An edit of robot.yaml or of a parameter file makes another robot, a copy of the folder does
    not.
    """
    hashes = []
    for copy_name, file_name, before, after in (
        ("same", "robot.yaml", "", ""),
        ("laser", "robot.yaml", "noise: 0.001", "noise: 0.002"),
        ("planner", "base_local_planner_params.yaml", "max_vel_x: 0.5", "max_vel_x: 0.6"),
    ):
        folder = tmp_path / copy_name / "jackal"
        shutil.copytree(JACKAL.folder, folder)
        edited_file = folder / file_name
        content = edited_file.read_text()
        assert before in content
        if before:
            edited_file.write_text(content.replace(before, after))
        hashes.append(runner.content(load(str(folder))))
    assert hashes[0] == runner.content(JACKAL)
    assert len(set(hashes)) == 3
