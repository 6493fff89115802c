"""Tests of train.py: learning, files of a run, resuming after a stop and after SIGKILL."""

import dataclasses
import functools
import json
import os
import re
import shutil
import sys

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from applr_ros1.common.files import write_json
from applr_ros1.common.tensors import unpack
from tests.support.ros import started
from tests.support.runs import NO_EVALUATION, main, network, one_line, toy, toy_run
from tests.support.training import Broken, Line, episode
from training.env.trajectory import TransitionLayout
from training.evaluate.periodic import PeriodicEvaluation
from training.evaluate.table import read_trials
from training.evaluate.trial import Result
from training.train.learner.config import parse
from training.train.learner.learner import Learner, LearnerOptions
from training.train.learner.run import TrainingRun
from training.train.replay.buffer import NO_ACTION
from training.workers.collect import Collect
from training.workers.pool import Pool


def networks_of(folder):
    """Return the networks of a run's checkpoint as bytes."""
    state = torch.load(folder / Learner.saved(folder)["learner"], weights_only=True)
    networks = state["networks"]
    return {layer_name: tensor.numpy().tobytes() for layer_name, tensor in networks.items()}


def rounds_of(run):
    """Return the rounds of evaluation that a run has recorded."""
    lines = (run / "evaluations.jsonl").read_text().splitlines()
    return list(map(json.loads, lines))


def numbers_of(rounds):
    """Return the numbers of rounds; 0 is the one before learning."""
    return [recorded["round"] for recorded in rounds]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Uninterrupted run of 800 transitions."""
    run_folder = tmp_path_factory.mktemp("whole") / "run"
    assert main(toy(run_folder, "--total-timesteps", "800")) == 0
    return run_folder


def test_a_run_learns_and_writes_all_its_files(whole):
    rounds = rounds_of(whole)
    assert numbers_of(rounds) == [0, 1, 2, 3, 4]
    first_round, *_, last_round = rounds
    assert last_round["return"] > first_round["return"] + 1.0, "the first policy stands still"
    for file_name in ("config.json", "checkpoint.json", "actor.safetensors", "best.safetensors"):
        assert (whole / file_name).is_file(), file_name
    best_policy = (whole / "best.safetensors").read_bytes()
    _, metadata = unpack(best_policy, "best")
    assert metadata["period_s"] == "0.5", "nodes and evaluations use the same period"
    policy = network(best_policy)
    (towards_left,) = policy(np.array([0.9]))
    (towards_right,) = policy(np.array([-0.9]))
    assert towards_left < -0.2
    assert towards_right > 0.2


def test_a_resumed_run_continues_with_further_episodes_and_counts_its_whole_time(
    tmp_path, monkeypatch
):
    # Given: a run that notes the numbers of its episodes
    numbers = []

    def noted(number, *arguments):
        numbers.append(number)
        return Collect(number, *arguments)

    monkeypatch.setattr("training.train.learner.run.Collect", noted)
    run_folder = tmp_path / "run"
    assert main(toy(run_folder, "--total-timesteps", "300")) == 0
    first_count = len(numbers)
    # As if it had driven for an hour: which of two short sessions is longer is chance.
    saved = Learner.saved(run_folder)
    saved["extra"]["elapsed"] += 3600.0
    write_json(run_folder / "checkpoint.json", saved)

    # When
    assert main(["--resume", "--out", str(run_folder), "--total-timesteps", "600"]) == 0

    # Then
    checkpoint = Learner.saved(run_folder)
    assert checkpoint["transitions"] == 600
    assert checkpoint["updates"] == 300
    assert numbers_of(rounds_of(run_folder)) == [0, 1, 2, 3]
    assert len(json.loads((run_folder / "config.json").read_text())["provenance"]) == 2
    assert 1 < first_count < len(numbers)
    assert numbers == list(range(len(numbers)))
    assert checkpoint["extra"]["elapsed"] > saved["extra"]["elapsed"] > 3600.0


def test_episodes_are_random_until_learning_starts_unless_a_policy_is_taken_over(
    tmp_path, monkeypatch
):
    # Given: a run that notes how its episodes of ten steps explore
    tasks = []

    def noted(*arguments):
        tasks.append(Collect(*arguments))
        return tasks[-1]

    monkeypatch.setattr("training.train.learner.run.Collect", noted)
    learner = tmp_path / "learner"
    # The noise falls by 0.1 per episode to 0.1.
    noise = ["--exploration-noise-final", "0.1", "--exploration-noise-steps", "40"]
    options = [*noise, *NO_EVALUATION, "--total-timesteps", "60", "--learning-starts", "30"]
    assert main(toy(learner, *options)) == 0

    # Then: the first 30 steps are random, and the noise follows the steps
    assert [task.random for task in tasks] == [True] * 3 + [False] * 3
    assert [task.sigma for task in tasks] == pytest.approx([0.5, 0.4, 0.3, 0.2, 0.1, 0.1])

    # A policy that has been learnt explores from the first step on.
    tasks.clear()
    assert main(toy(tmp_path / "taken_over", *options, "--init-from", learner)) == 0
    assert [task.random for task in tasks] == [False] * 6


def test_an_overwritten_ring_is_restored_from_its_checkpoints(tmp_path):
    """A changed --utd-ratio applies from the resume on."""
    layout = TransitionLayout(4, 2, 2)
    options = LearnerOptions(
        net_arch=[8],
        batch_size=8,
        utd_ratio=1.0,
        learning_starts=5,
    )
    learner = Learner(layout, options, tmp_path, 50)
    for number in range(12):
        learner.add_trajectory(episode(layout, number, 10))
        while learner.updates_due:
            learner.update()
        learner.save()
    # A ring of 50 rows holds the last five episodes, each with its observation at the end.
    resumed = Learner(layout, options.model_copy(update={"utd_ratio": 2.0}), tmp_path, 50)
    assert actions_in(resumed.replay) == actions_in(learner.replay)
    assert len(list(tmp_path.glob("replay-*"))) == 5
    # One update for each transition after the first five; none is made up for later.
    assert resumed.transitions == 120
    assert resumed.td3.updates == 115
    assert resumed.updates_due == 0
    resumed.add_trajectory(episode(layout, 12, 10))
    assert resumed.updates_due == 20


def actions_in(replay):
    """Return all actions of a replay memory as bytes, sorted."""
    actions = replay.action[replay.end != NO_ACTION]
    return sorted(row.tobytes() for row in actions)


def test_the_last_policy_within_the_minutes_is_evaluated(tmp_path, monkeypatch):
    # The minute is over once 250 steps are driven, between two evaluations.
    monkeypatch.setattr(TrainingRun, "elapsed", property(lambda run: 60.0 * (run.steps >= 250)))
    run_folder = tmp_path / "run"
    assert main(toy(run_folder, "--minutes", "1")) == 0
    rounds = [(recorded["round"], recorded["step"]) for recorded in rounds_of(run_folder)]
    assert rounds == [(0, 0), (1, 200), (1, 250)]


@pytest.mark.parametrize(
    ("init_from", "bound_share", "first_lines"),
    [
        ("dwa", 0.89, r"before learning: .*, the best so far\ndwa: .*: a policy has room"),
        ("dwa", 0.92, r"before learning: .*\ndwa: .*: within a tenth, no policy is needed"),
        ("", 0.92, r"default DWA: .*\d s\)\nDone.*"),
    ],
)
def test_a_run_says_first_whether_its_parameter_set_leaves_room(
    init_from, bound_share, first_lines, tmp_path, monkeypatch, capsys
):
    # Given: a bound that is this share of the time with the parameter set
    def bound_s(world, robot):
        (time_s,) = read_trials(tmp_path / "run/evaluation/trials.csv").time_s
        return bound_share * time_s

    monkeypatch.setattr("training.train.learner.run.bound_s", bound_s)
    config = parse(toy(tmp_path / "run", "--total-timesteps", "20", "--init-from", init_from))
    vars(config).update(start=(np.zeros(1) if init_from else None, {}))
    run = toy_run(config)
    run.preparation = dataclasses.replace(run.preparation, held_out=[("environment", "", None)])

    assert run.run() == 0

    assert re.match(first_lines, capsys.readouterr().out)


# Program that saves ten times a second, so that a test need not wait for a checkpoint.
OFTEN_SAVED = """
import sys
from training.train.learner import run
from tests.support.runs import (main)
run.CHECKPOINT_SECONDS = 0.1
sys.exit(main())
"""


def left_at_each_write(command, folder, copies, monkeypatch):
    """Execute a command, copy its folder to copies/0, copies/1, ... before each write, and return
    the name of the function of each write.

    A copy is made when the new content exists but does not have its final name yet.
    """
    function_names = []

    def copying(function_name):
        original = getattr(os, function_name)

        def write(*arguments, **options):
            if folder.exists():
                shutil.copytree(folder, copies / str(len(function_names)))
            function_names.append(function_name)
            return original(*arguments, **options)

        return write

    with monkeypatch.context() as patch:
        for function_name in ("fsync", "replace"):
            patch.setattr(os, function_name, copying(function_name))
        command()
    return function_names


@pytest.mark.heavy
@pytest.mark.fault("19")
def test_a_run_killed_at_any_write_continues(tmp_path, monkeypatch):
    monkeypatch.setattr("training.train.learner.run.provenance", lambda seed: {})
    monkeypatch.setattr("training.train.learner.run.CHECKPOINT_SECONDS", 0.0)
    whole_run = tmp_path / "whole"
    options = ["--total-timesteps=20", "--eval-freq=20", "--net-arch=8"]
    arguments = toy(whole_run, *options)
    function_names = left_at_each_write(lambda: main(arguments), whole_run, tmp_path, monkeypatch)
    assert set(function_names) == {"fsync", "replace"}
    for number, function_name in enumerate(function_names):
        run_folder = tmp_path / str(number)
        # Before its first file, a run is started again as it was.
        if (run_folder / "config.json").exists():
            next_arguments = ["--resume", "--out", str(run_folder)]
        else:
            next_arguments = toy(run_folder, *options)
        assert main(next_arguments) == 0
        saved = Learner.saved(run_folder)
        assert saved["transitions"] == 20, f"killed at write {number}, {function_name}"


@pytest.mark.fault("23")
def test_ctrl_c_saves_and_stops(tmp_path):
    run_folder = tmp_path / "run"
    arguments = [*toy(run_folder, "--total-timesteps", "1000000"), "__name:=train"]
    command = [sys.executable, "-c", OFTEN_SAVED, *arguments]
    process = started(command, os.environ, tmp_path / "log")
    process.until(lambda: (Learner.saved(run_folder) or {}).get("transitions"))
    assert process.end() == 130
    assert "Stopped by SIGINT and saved" in process.text
    assert Learner.saved(run_folder)["transitions"] > 0


def test_a_run_starts_with_the_networks_of_another_run(whole, tmp_path, capsys):
    # Given: a run that takes over the networks of a copy, and learns nothing at first
    source = tmp_path / "source"
    run_folder = tmp_path / "run"
    shutil.copytree(whole, source)
    options = ["--total-timesteps", "50", "--learning-starts", "40", "--gamma", "0.9"]
    assert main([*toy(run_folder, "--init-from", source, *options), "--utd-ratio", "0"]) == 0

    # Then: its networks are those of the other run, and so is its policy
    assert networks_of(run_folder) == networks_of(whole)
    saved = Learner.saved(run_folder)
    assert saved["updates"] == 0
    assert saved["transitions"] == 50
    policy = network((run_folder / "actor.safetensors").read_bytes())
    # The toy's robot is to drive towards 0 from either side.
    assert policy(np.array([0.9]))[0] < -0.2
    assert policy(np.array([-0.9]))[0] > 0.2

    # The run needs its source only until its first checkpoint. Unlike the file of a policy, a run
    # has trained critics, so its policy is not frozen at first.
    shutil.rmtree(source)
    options = ["--total-timesteps", "100", "--utd-ratio", "1"]
    assert main(["--resume", "--out", str(run_folder), *options]) == 0
    assert Learner.saved(run_folder)["updates"] == 50
    later_policy = network((run_folder / "actor.safetensors").read_bytes())
    assert later_policy(np.array([0.9])) != policy(np.array([0.9]))

    # Networks of another shape are refused, and names that are no run.
    other_shape = toy(tmp_path / "b", "--init-from", whole, "--net-arch", "8")
    one_line(capsys, other_shape, "give the same --net-arch")
    other_critics = toy(tmp_path / "c", "--init-from", whole, "--layer-norm")
    one_line(capsys, other_critics, "its critics have layer_norm False")
    for source_name in (tmp_path, "random"):
        no_run = toy(tmp_path / "d", "--init-from", source_name)
        one_line(capsys, no_run, "--init-from is .*: give static, dwa, a JSON")


def test_a_run_is_not_overwritten_and_not_mixed_up(whole, tmp_path, capsys):
    networks_before = networks_of(whole)
    one_line(capsys, toy(whole), "already holds a run: continue it with --resume")
    busy_run = toy_run(parse(toy(tmp_path / "busy", "--total-timesteps", "10")))
    one_line(capsys, ["--resume", "--out", tmp_path / "busy"], "another ./applr train works")
    busy_run.lock.close()
    assert networks_of(whole) == networks_before


class Bomb:
    """Object whose pickle makes a folder when it is read."""

    def __reduce__(self):
        return os.mkdir, ("executed",)


def test_a_pickle_in_a_checkpoint_is_not_executed(whole, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(whole, tmp_path / "copy")
    torch.save(Bomb(), tmp_path / "copy" / Learner.saved(whole)["learner"])
    one_line(capsys, ["--resume", "--out", "copy"], r"learner-.*: cannot be read; ")
    assert not (tmp_path / "executed").exists()


@pytest.mark.fault("21")
def test_a_full_disk_leaves_the_last_checkpoint(whole, tmp_path, monkeypatch, capsys):
    run_folder = tmp_path / "copy"
    shutil.copytree(whole, run_folder)
    checkpoint = Learner.saved(run_folder)
    original = os.fsync

    def full(descriptor):
        if "learner" in os.readlink("/proc/self/fd/%d" % descriptor):
            raise OSError(28, "No space left on device")
        return original(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    one_line(capsys, ["--resume", "--out", run_folder, "--total-timesteps", "900"], "No space left")
    monkeypatch.undo()
    assert Learner.saved(run_folder) == checkpoint
    assert not list(run_folder.glob("*.partial"))
    assert main(["--resume", "--out", str(run_folder), "--total-timesteps", "900"]) == 0


def test_a_run_whose_episodes_all_fail_ends_in_one_line(tmp_path, capsys):
    broken = functools.partial(main, env=Broken)
    problem = "20 episodes in a row failed: RuntimeError: the wheels came off"
    one_line(capsys, toy(tmp_path / "a", *NO_EVALUATION), problem, broken)


@pytest.mark.parametrize("has_start", [False, True])
def test_rounds_are_continued_and_the_lowest_score_is_the_best(has_start, tmp_path):
    def evaluation():
        """Return an evaluation every 100 steps, which continues with what the folder has."""
        return PeriodicEvaluation(tmp_path, [("w0", "w0"), ("w1", "w1")], 100, 0, has_start)

    def drive(rounds, step, seconds):
        """Drive the round that is due, with trials of some duration, and return its summary."""

        def run(trial, weights):
            result = Result(
                success=seconds < 100,
                collided=seconds < 10 and trial.world == "w1",
                time_s=seconds,
                decisions=5,
                total_reward=-seconds,
            )
            return result, b""

        number = rounds.due(step)
        weights = bytes([step % 251])
        summary = rounds.drive(number, Pool(0), run, weights, step=step, version=step)
        assert rounds.due(step) is None
        return summary

    first_session = evaluation()
    start = drive(first_session, 0, 20.0)
    # The default parameters are no policy that a run could return.
    assert (start["round"], start["best"]) == (0, has_start)
    summary = drive(first_session, 130, 10.0)
    assert summary["round"] == 1
    assert summary["score"] == 10.0
    assert summary["best"]
    # The next one is faster, and touches something in one of the worlds.
    assert not drive(first_session, 210, 9.0)["best"]

    second_session = evaluation()
    assert second_session.best["step"] == 130
    assert second_session.history[0] == start
    assert second_session.due(299) is None
    second_session.every = 150  # A --resume has changed the interval since the earlier rounds.
    assert second_session.due(299) is None
    assert second_session.due(300) == 2

    # At the end of a run, the last policy is evaluated, too.
    assert second_session.due(209, last=True) is None
    assert second_session.due(211, last=True) == 1

    summary = drive(evaluation(), 310, 100.0)
    assert summary["round"] == 3
    assert not summary["best"]
    assert summary["time_s"] is None
    assert summary["score"] == 100.0


def test_ctrl_c_ends_an_evaluation_whose_trials_are_kept(tmp_path):
    run = toy_run(parse(toy(tmp_path / "run", "--actors", "0")))
    drive = run.preparation.drive

    def stop(trial, weights):
        run.stopping = "SIGINT"
        return drive(trial, weights)

    run.preparation = dataclasses.replace(run.preparation, drive=stop)
    assert run.run() == 130
    assert run.evaluation.history == []
    assert len(read_trials(tmp_path / "run/evaluation/trials.csv")) == 1


class TwoTerms(Line):
    """Line whose reward consists of two terms."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        terms = {"near": 0.25 * reward, "far": 0.75 * reward}
        return observation, reward, terminated, truncated, dict(info, reward=terms)


def test_tensorboard_shows_terms_of_the_reward(tmp_path):
    run_folder = tmp_path / "run"
    assert main(toy(run_folder, *NO_EVALUATION, "--total-timesteps", "100"), TwoTerms) == 0
    assert main(["--resume", "--out", str(run_folder), "--total-timesteps", "140"], TwoTerms) == 0
    near_events = []
    far_events = []
    total_events = []
    for events_file in (run_folder / "tensorboard").iterdir():
        session = EventAccumulator(str(events_file)).Reload()
        near_events += session.Scalars("reward/near")
        far_events += session.Scalars("reward/far")
        total_events += session.Scalars("episode/return")
    # Episodes of ten steps, of both sessions.
    assert len(near_events) == len(total_events) == 14
    for near_event, far_event, total_event in zip(near_events, far_events, total_events):
        episode_return = total_event.value
        assert near_event.value == pytest.approx(0.25 * episode_return, abs=1e-4)
        assert near_event.value + far_event.value == pytest.approx(episode_return, abs=1e-4)
