"""train.py: runs learn, leave everything behind, resume to the same numbers, and survive SIGKILL."""

import functools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from applr_ros1.common.tensors import unpack
from tests.support import HANGS, ROOT
from tests.support.kills import Killed, left_at_each_write
from tests.support.toy_env import Line
from tests.support.toy_training import NO_EVALUATION, main, one_line, state_of, toy, toy_run
from training.learner.config import parse
from training.learner.learner import Learner
from training.replay.store import TrajectoryStore
from training.train import TrainingRun
from training.trials.periodic import PeriodicEvaluation
from training.trials.trial import Result
from training.workers.collect import PolicyWeights


def rounds_of(run):
    return [json.loads(line) for line in (run / "evaluations.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted run of 800 transitions."""
    out = tmp_path_factory.mktemp("whole") / "run"
    assert main(toy(out, "--total-timesteps", "800")) == 0
    return out


def test_learns_and_leaves_everything_behind(whole):
    rounds = rounds_of(whole)
    assert [r["round"] for r in rounds] == [-1, 1, 2, 3, 4]
    assert rounds[-1]["return"] > rounds[0]["return"] + 1.0  # standing still
    files = {"config.json", "checkpoint.json", "replay.sqlite", "actor.safetensors", "best.safetensors"}
    assert {p.name for p in whole.iterdir()} >= files
    infos = TrajectoryStore(whole).infos()
    assert [info["transitions"] for info in infos] == [10] * 80
    assert np.mean([info["return"] for info in infos[-20:]]) > np.mean([info["return"] for info in infos[:20]])
    best = (whole / "best.safetensors").read_bytes()
    assert unpack(best, "best")[1]["period_s"] == "0.5"  # nodes and evaluations decide as often
    policy = PolicyWeights(best)
    assert policy(np.array([0.9]))[0] < -0.2 < 0.2 < policy(np.array([-0.9]))[0]


def test_resume_continues_to_the_same_numbers(whole, tmp_path):
    out = tmp_path / "run"
    assert main(toy(out, "--total-timesteps", "300", "--buffer-size", "1880", "--exploration-noise-steps", "614")) == 0
    assert main(["--resume", "--out", str(out), "--total-timesteps", "800"]) == 0
    assert state_of(out) == state_of(whole)
    assert rounds_of(out) == rounds_of(whole)
    assert len(json.loads((out / "config.json").read_text())["provenance"]) == 2


def test_a_ring_that_has_been_around_resumes_to_the_same_numbers(tmp_path):
    """The arrays of overwritten episodes are dropped from the file; their numbers are not forgotten."""
    small = ["--buffer-size", "100", "--exploration-noise-steps", "600", *NO_EVALUATION]
    assert main(toy(tmp_path / "whole", "--total-timesteps", "600", *small)) == 0
    assert main(toy(tmp_path / "run", "--total-timesteps", "300", *small)) == 0
    assert TrajectoryStore(tmp_path / "run").dropped() == (20, 200)
    assert main(["--resume", "--out", str(tmp_path / "run"), "--total-timesteps", "600"]) == 0
    assert state_of(tmp_path / "run") == state_of(tmp_path / "whole")
    assert len(TrajectoryStore(tmp_path / "run").infos()) == 60


@pytest.mark.parametrize(("seeds", "at_the_end"), [("1", [(-1, 250), (1, 250)]), ("2", [(1, 250)])])
def test_the_policy_at_the_end_of_the_minutes_is_evaluated_beside_the_default(seeds, at_the_end, tmp_path, monkeypatch):
    monkeypatch.setattr(TrainingRun, "elapsed", property(lambda run: 60.0 * (run.steps >= 250)))
    assert main(toy(tmp_path / "run", "--minutes", "1", "--seeds", seeds)) == 0
    assert [(r["round"], r["step"]) for r in rounds_of(tmp_path / "run")] == [(1, 200), *at_the_end]


OFTEN_SAVED = """
import sys
from training import train as run
from tests.support.toy_training import main
run.CHECKPOINT_SECONDS = 0.1
sys.exit(main())
"""


def kill_and_resume(out, times, steps, seed=0):
    """Start the run, kill it at a random moment, resume, and so on; at last let it finish. Returns how often it was
    killed: a run may be over before.
    """
    rng, resume, killed = random.Random(seed), False, 0

    def start():
        arguments = ["--resume", "--out", str(out)]
        if not resume:
            arguments = toy(out, "--total-timesteps", steps)
        command = [sys.executable, "-c", OFTEN_SAVED, *arguments]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    def taken():
        return TrajectoryStore(out).last if (out / "config.json").exists() else 0

    for _ in range(times):
        before, process = taken(), start()
        deadline = time.monotonic() + HANGS
        while time.monotonic() < deadline and process.poll() is None and taken() == before:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.25))
        process.send_signal(signal.SIGKILL)
        killed += process.wait() == -signal.SIGKILL
        process.stderr.close()
        resume = (out / "config.json").exists()
    if times > 1:
        process = start()
        assert process.wait(900) == 0, process.stderr.read().decode()
    else:
        assert main(["--resume", "--out", str(out)]) == 0
    return killed


@pytest.mark.fault("19")
@pytest.mark.parametrize(("times", "steps"), [(1, 1000), pytest.param(50, 15000, marks=pytest.mark.long)])
def test_sigkill_at_random_moments_loses_nothing(tmp_path, measured, times, steps):
    """Killed so many times, it ends with the very weights, replay and random state of a run that never was."""
    killed = kill_and_resume(tmp_path / "killed", times, steps)
    assert killed > times / 2
    assert main(toy(tmp_path / "whole", "--total-timesteps", steps)) == 0
    assert state_of(tmp_path / "killed") == state_of(tmp_path / "whole")
    assert rounds_of(tmp_path / "killed") == rounds_of(tmp_path / "whole")
    measured("kills survived", killed, "")


@pytest.mark.fault("19")
@pytest.mark.parametrize("seconds", [0.0, 1e9], ids=["many checkpoints", "one at the end"])
def test_killed_at_any_of_its_writes_a_run_loses_nothing(tmp_path, monkeypatch, seconds):
    """Checkpoint, policies, rounds and store, of which a part has been dropped: the next session goes on from each."""
    monkeypatch.setattr("training.train.provenance", lambda seed: {})
    monkeypatch.setattr("training.train.CHECKPOINT_SECONDS", seconds)
    whole, options = tmp_path / "whole", ["--total-timesteps=20", "--buffer-size=11", "--eval-freq=20", "--net-arch=8"]

    def end_of(out):
        best = unpack((out / "best.safetensors").read_bytes(), "best")[0]
        return state_of(out), rounds_of(out), {name: array.tobytes() for name, array in best.items()}

    writes = left_at_each_write(lambda: main(toy(whole, *options)), whole, tmp_path, monkeypatch)
    assert set(writes) == {"fsync", "replace", "append", "note", "forget"}
    for number, name in enumerate(writes):
        out = tmp_path / str(number)
        again = ["--resume", "--out", str(out)] if (out / "config.json").exists() else toy(out, *options)
        assert main(again) == 0
        assert end_of(out) == end_of(whole), f"killed at write {number}, {name}"


@pytest.mark.fault("23")
def test_ctrl_c_saves_and_stops(tmp_path):
    out = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-c", OFTEN_SAVED, *toy(out, "--total-timesteps", "1000000"), "__name:=train"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    while not (out / "config.json").exists() or not TrajectoryStore(out).last:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    text, _ = process.communicate(timeout=HANGS)
    assert process.returncode == 130
    assert "Stopped by SIGINT and saved" in text
    assert Learner.saved(out)["transitions"] > 0


def test_a_run_begins_with_the_networks_of_another(whole, tmp_path, capsys):
    source, out = tmp_path / "source", tmp_path / "run"
    shutil.copytree(whole, source)
    first = toy(out, "--init-from", source, "--total-timesteps", "50", "--learning-starts", "40", "--gamma", "0.9")
    assert main([*first, "--utd-ratio", "0"]) == 0
    assert state_of(out)[0] == state_of(whole)[0]
    assert (Learner.saved(out)["updates"], Learner.saved(out)["transitions"]) == (0, 50)
    policy = PolicyWeights((out / "actor.safetensors").read_bytes())
    assert policy(np.array([0.9]))[0] < -0.2 < 0.2 < policy(np.array([-0.9]))[0]  # as the other run's
    shutil.rmtree(source)  # from its first checkpoint on the run stands by itself
    assert main(["--resume", "--out", str(out), "--total-timesteps", "100", "--utd-ratio", "1"]) == 0
    assert Learner.saved(out)["updates"] == 50
    assert state_of(out)[0] != state_of(whole)[0]
    one_line(capsys, toy(tmp_path / "b", "--init-from", whole, "--net-arch", "8"), "give the same --net-arch")
    one_line(capsys, toy(tmp_path / "c", "--init-from", whole, "--layer-norm"), "its critics have layer_norm False")
    one_line(capsys, toy(tmp_path / "d", "--init-from", tmp_path), "--init-from is .*: give static, dwa, a JSON")
    assert not (tmp_path / "d").exists()


def test_a_run_is_not_overwritten_and_not_mixed_up(whole, tmp_path, capsys):
    before = state_of(whole)
    one_line(capsys, toy(whole), "holds a run already: --resume")
    one_line(capsys, ["--resume", "--out", whole, "--net-arch", "64"], r"--net-arch \[64\]: .* cannot be changed")
    run = toy_run(parse(toy(tmp_path / "busy", "--total-timesteps", "10")))
    one_line(capsys, ["--resume", "--out", tmp_path / "busy"], "another train.py works")
    run.lock.close()
    stored = json.loads((whole / "config.json").read_text())
    for change, pattern in (
        ({"colour": 1}, "unknown option 'colour'"),
        ({"gamma": "x"}, "gamma is 'x': input should be a valid number"),
    ):
        other = tmp_path / ("stored%d" % len(pattern))
        other.mkdir()
        (other / "config.json").write_text(json.dumps({**stored, **change}))
        one_line(capsys, ["--resume", "--out", other], pattern)
    assert state_of(whole) == before


def test_damaged_files_of_a_run_are_refused(whole, tmp_path, capsys):
    def damage(path):
        path.write_bytes(path.read_bytes()[:-9] + b"damaged!!")

    for name, harm, pattern in (
        ("checkpoint.json", lambda p: p.write_bytes(p.read_bytes()[:100]), "not JSON"),
        ("learner", damage, "checksum"),
        ("learner", lambda p: p.unlink(), "cannot be read"),
        ("replay.sqlite", lambda p: p.write_bytes(p.read_bytes()[:20000]), "malformed|damaged"),
        ("replay.sqlite", lambda p: p.unlink(), "missing or damaged"),
    ):
        copy = tmp_path / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(whole, copy)
        harm(copy / name if name != "learner" else next(copy.glob("learner-*.safetensors")))
        one_line(capsys, ["--resume", "--out", copy, "--total-timesteps", "900"], pattern)


@pytest.mark.fault("21")
def test_a_full_disk_leaves_the_last_checkpoint(whole, tmp_path, monkeypatch, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(whole, copy)
    before, real = Learner.saved(copy), os.fsync

    def full(descriptor):
        if "learner" in os.readlink("/proc/self/fd/%d" % descriptor):
            raise OSError(28, "No space left on device")
        return real(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    one_line(capsys, ["--resume", "--out", copy, "--total-timesteps", "900"], "No space left")
    monkeypatch.undo()
    assert Learner.saved(copy) == before
    assert not list(copy.glob("*.partial"))
    assert main(["--resume", "--out", str(copy), "--total-timesteps", "900"]) == 0


def test_a_best_policy_that_was_not_kept_is_driven_again(tmp_path, monkeypatch):
    """Killed between the round's line and its policy; and the file of an older best one does not pass for it."""
    options = ["--total-timesteps", "400", "--eval-freq", "100"]
    whole = tmp_path / "whole"
    assert main(toy(whole, *options)) == 0
    best = [r for r in rounds_of(whole) if r["best"]]
    assert len(best) > 1
    export, exported = TrainingRun.export, []

    def killed(self, path, weights, result):
        if result:
            exported.append(result)
            if len(exported) == number:
                raise Killed
        export(self, path, weights, result)

    for number in (1, 2):
        out = tmp_path / str(number)
        exported.clear()
        with monkeypatch.context() as patch:
            patch.setattr(TrainingRun, "export", killed)
            with pytest.raises(Killed):
                toy_run(parse(toy(out, *options))).run()
        assert (out / "best.safetensors").exists() == (number > 1)
        assert main(["--resume", "--out", str(out)]) == 0
        assert rounds_of(out) == rounds_of(whole)
        weights, header = unpack((out / "best.safetensors").read_bytes(), "best")
        theirs, expected = unpack((whole / "best.safetensors").read_bytes(), "best")
        assert json.loads(header["result"]) == json.loads(expected["result"]) == best[-1]
        assert all(np.array_equal(weights[name], theirs[name]) for name in theirs)
        assert state_of(out) == state_of(whole)


def test_runs_whose_episodes_all_fail_or_are_refused_end_in_one_line(tmp_path, capsys):
    broken = functools.partial(main, env="tests.support.toy_env:Broken")
    words = "20 episodes in a row failed: RuntimeError: the wheels came off"
    one_line(capsys, toy(tmp_path / "a", *NO_EVALUATION), words, broken)
    small = ["--buffer-size", "4", *NO_EVALUATION]  # fewer than the rows of one episode
    one_line(capsys, toy(tmp_path / "b", *small), "200 episodes in a row were refused: ")


def test_another_simulator_begins_anew_with_default_and_best(tmp_path):
    """Its times are no rivals of the first one's."""

    def made(trials=2, setting="kinematic"):
        worlds = [("w0", "w0"), ("w1", "w1")]
        return PeriodicEvaluation(tmp_path, worlds, trials, 100, 0, 4.0, setting=setting)

    def drive(rounds, step, seconds):
        for number in iter(lambda: rounds.due(step), None):
            for trial in rounds.begin(number, step, step):
                touched = trial.world == "w1"
                result = Result(seconds < 100, touched, False, seconds, decisions=5, total_reward=-seconds)
                summary = rounds.add(result)
            yield summary

    first = made()
    assert [s["round"] for s in drive(first, 0, 20.0)] == [-1]
    (summary,) = drive(first, 130, 10.0)
    assert (summary["round"], summary["score"], summary["best"]) == (1, 12.0, True)
    assert [s["best"] for s in drive(first, 210, 11.0)] == [False]
    again = made()
    assert again.best["step"] == 130
    assert again.default["time_s"] == 20.0
    assert again.due(299) is None
    again.every = 150  # changed at a --resume: the rounds so far were counted otherwise
    assert [again.due(step) for step in (299, 300)] == [None, 2]
    summaries = list(drive(made(setting="pybullet"), 310, 100.0))
    assert [(s["round"], s["best"]) for s in summaries] == [(-1, False), (3, True)]
    assert summaries[1]["time_s"] is None
    assert summaries[1]["score"] == 102.0
    assert made(trials=3).best is None  # nor are rounds of another number of trials


class TwoTerms(Line):
    """A line whose reward consists of two terms."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        terms = {"near": 0.25 * reward, "far": 0.75 * reward}
        return observation, reward, terminated, truncated, dict(info, reward=terms)


def test_tensorboard_shows_terms_of_the_reward(tmp_path, monkeypatch):
    out = tmp_path / "run"
    monkeypatch.syspath_prepend(os.path.dirname(__file__))
    assert main(toy(out, *NO_EVALUATION, "--total-timesteps", "100"), "test_train:TwoTerms") == 0
    assert main(["--resume", "--out", str(out), "--total-timesteps", "140"], "test_train:TwoTerms") == 0
    written = EventAccumulator(str(out / "tensorboard"), size_guidance={"scalars": 0}).Reload()
    near, far, total = (written.Scalars(tag) for tag in ("reward/near", "reward/far", "episode/return"))
    trajectories = [trajectory for _, trajectory in TrajectoryStore(out).trajectories()]
    assert len(near) == len(total) == len(trajectories) == 14
    for a, b, c, trajectory in zip(near, far, total, trajectories):
        assert a.value == pytest.approx(0.25 * trajectory.reward.sum(), abs=1e-4)
        assert a.value + b.value == pytest.approx(c.value, abs=1e-4)
