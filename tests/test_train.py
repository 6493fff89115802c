"""train.py: runs, resumes to the same numbers, survives SIGKILL, and says in one line what is wrong."""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from applr_ros1.common.tensors import unpack
from training.evaluation.periodic import PeriodicEvaluation
from training.experience.dataset import Dataset, DatasetError, Writer, export_replay
from training.experience.trajectory import Layout, Trajectory
from training.gorila import config as options
from training.gorila.config import ConfigError, TrainConfig, parse
from training.gorila.learner import Learner
from training.gorila.progress import status
from training.gorila.run import TrainingRun
from training.td3.td3 import LearnerError
from training.train import main
from training.workers.tasks import Answer, TrialResult
from training.workers.worker import PolicyWeights

ROOT = Path(__file__).resolve().parents[1]
TOY = [
    "--env",
    "tests.toy_env:Line",
    "--hidden",
    "32,32",
    "--batch-size",
    "32",
    "--updates-per-transition",
    "0.5",
    "--eval-every",
    "200",
    "--no-tensorboard",
    "--device=cpu",
    "--threads=1",
    "--actor-lr=1e-3",
    "--period=0.5",
]


def toy(out, *more):
    return [*TOY, "--out", str(out), *more]


def state_of(folder):
    """Everything that learning goes on from, bit for bit."""
    checkpoint = Learner.saved(folder)
    arrays, header = unpack((Path(folder) / checkpoint["learner"]["file"]).read_bytes(), "state", LearnerError)
    data = {name: array.tobytes() for name, array in arrays.items()}
    keys = ("transitions", "updates", "rows", "episodes", "rng", "seen")
    return data, header, {key: checkpoint[key] for key in keys}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted run of 800 transitions."""
    out = tmp_path_factory.mktemp("whole") / "run"
    assert main(toy(out, "--steps", "800")) == 0
    return out


def test_learns_and_leaves_everything_behind(whole):
    rounds = [json.loads(line) for line in (whole / "evaluations.jsonl").read_text().splitlines()]
    assert [r["round"] for r in rounds] == [-1, 1, 2, 3, 4]
    assert rounds[-1]["return"] > rounds[1]["return"] + 1.0
    assert {p.name for p in whole.iterdir()} >= {
        "config.json",
        "checkpoint.json",
        "journal",
        "actor.safetensors",
        "best.safetensors",
        "episodes.csv",
        "curves.png",
    }
    assert len((whole / "episodes.csv").read_text().splitlines()) == 81
    best = (whole / "best.safetensors").read_bytes()
    assert unpack(best, "best", LearnerError)[1]["period_s"] == "0.5"  # nodes and evaluations decide as often
    policy = PolicyWeights(best)
    assert policy(np.array([0.9]))[0] < -0.3 < 0.3 < policy(np.array([-0.9]))[0]


def test_resume_continues_to_the_same_numbers(whole, tmp_path):
    out = tmp_path / "run"
    assert main(toy(out, "--steps", "300", "--capacity", "1880", "--noise-steps", "614")) == 0
    assert main(["--resume", "--out", str(out), "--steps", "800"]) == 0
    assert state_of(out) == state_of(whole)
    assert (out / "episodes.csv").read_text() == (whole / "episodes.csv").read_text()
    assert (out / "evaluations.jsonl").read_text() == (whole / "evaluations.jsonl").read_text()


def kill_and_resume(out, times, steps, seed=0):
    """Start the run, kill it at a random moment, resume, and so on; at last let it finish. Returns how often it was
    killed: a run may be over before.
    """
    rng, resume, killed = random.Random(seed), False, 0

    def start():
        arguments = ["--resume", "--out", str(out)]
        if not resume:
            arguments = toy(out, "--steps", str(steps), "--checkpoint-every", "0.1")
        command = [sys.executable, "-m", "training.train", *arguments]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    for _ in range(times):
        process = start()
        begun, deadline = out / "journal" / "000000.segment", time.monotonic() + 60
        before = begun.stat().st_size if begun.exists() else 0
        while (
            time.monotonic() < deadline
            and process.poll() is None
            and (not begun.exists() or begun.stat().st_size == before)
        ):
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.25))
        process.send_signal(signal.SIGKILL)
        killed += process.wait() == -signal.SIGKILL
        process.stderr.close()
        resume = (out / "config.json").exists()
    process = start()
    assert process.wait(900) == 0, process.stderr.read().decode()
    return killed


@pytest.mark.parametrize(("times", "steps"), [(3, 1500), pytest.param(50, 15000, marks=pytest.mark.long)])
def test_sigkill_at_random_moments_loses_nothing(tmp_path, measured, times, steps):
    """Killed so many times, it ends with the very weights, replay and random state of a run that never was."""
    killed = kill_and_resume(tmp_path / "killed", times, steps)
    assert killed > times / 2
    assert main(toy(tmp_path / "whole", "--steps", str(steps))) == 0
    assert state_of(tmp_path / "killed") == state_of(tmp_path / "whole")
    for name in ("episodes.csv", "evaluations.jsonl"):
        assert (tmp_path / "killed" / name).read_text() == (tmp_path / "whole" / name).read_text()
    measured("kills survived", killed, "")


def test_ctrl_c_saves_and_stops(tmp_path):
    out = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-m", "training.train", *toy(out, "--steps", "1000000"), "__name:=train"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    while not (out / "journal" / "000000.segment").exists():
        assert process.poll() is None
        time.sleep(0.02)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    text, _ = process.communicate(timeout=10)
    assert process.returncode == 130
    assert "Stopped by SIGINT and saved" in text
    assert Learner.saved(out)["transitions"] > 0


def test_offline_from_a_runs_own_journal(whole, tmp_path):
    """TD3+BC on what the run collected drives better than the data; resumed half-way it ends the same."""
    layout = Layout(0, 1, 1)
    assert export_replay(whole, tmp_path / "data", layout)["transitions"] == 800
    offline = ["--dataset", str(tmp_path / "data"), "--bc-alpha", "2.5", "--eval-every", "100"]
    assert main(toy(tmp_path / "a", *offline, "--updates", "400")) == 0
    assert main(toy(tmp_path / "b", *offline, "--updates", "150")) == 0
    assert main(["--resume", "--out", str(tmp_path / "b"), "--updates", "400"]) == 0
    assert state_of(tmp_path / "a") == state_of(tmp_path / "b")
    assert str(tmp_path).encode() not in (tmp_path / "a" / "actor.safetensors").read_bytes()  # names no folders
    rounds = [json.loads(line) for line in (tmp_path / "a" / "evaluations.jsonl").read_text().splitlines()]
    assert rounds[-1]["return"] > -1.0
    assert main(toy(tmp_path / "c", "--dataset", str(tmp_path / "data"), "--mix", "--steps", "1000")) == 0
    assert Learner.saved(tmp_path / "c")["transitions"] == 1800  # 1000 of them collected


def test_a_run_begins_with_the_networks_of_another(whole, tmp_path, capsys):
    source, out = tmp_path / "source", tmp_path / "run"
    shutil.copytree(whole, source)
    first = toy(out, "--start", str(source), "--steps", "50", "--warmup", "40", "--gamma", "0.9")
    assert main([*first, "--updates-per-transition", "0"]) == 0
    assert state_of(out)[0] == state_of(whole)[0]
    assert (Learner.saved(out)["updates"], Learner.saved(out)["transitions"]) == (0, 50)
    policy = PolicyWeights((out / "actor.safetensors").read_bytes())
    assert policy(np.array([0.9]))[0] < -0.3 < 0.3 < policy(np.array([-0.9]))[0]  # as the other run's
    shutil.rmtree(source)  # from its first checkpoint on the run stands by itself
    assert main(["--resume", "--out", str(out), "--steps", "100", "--updates-per-transition", "1"]) == 0
    assert Learner.saved(out)["updates"] == 50
    assert state_of(out)[0] != state_of(whole)[0]
    assert parse(["--start", "static_per_metre"]).start_run == ""  # a set by its name is no run
    one_line(capsys, toy(tmp_path / "b", "--start", str(whole), "--hidden", "8"), 1, "give the same --hidden")
    one_line(capsys, toy(tmp_path / "c", "--start", str(tmp_path)), 2, "--start is .*: give static, a JSON file")
    assert not (tmp_path / "c").exists()


def one_line(capsys, arguments, status, pattern):
    assert main([str(a) for a in arguments]) == status
    error = capsys.readouterr().err.strip()
    assert error.count("\n") == 0, error
    assert error.startswith("train.py: "), error
    assert re.search(pattern, error), error


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--learning-rate", "1"], "unrecognized arguments: --learning-rate 1; --help"),
        (["--steps", "many"], "'many' is no whole number"),
        (["--hidden", "512,0"], "--hidden is '512,0': give 1 to 15 sizes"),
        (["--hidden", "512,99999"], "--hidden"),
        (["--batch-size", "0"], "--batch-size is 0: give 1 to"),
        (["--gamma", "1.5"], "--gamma is 1.5"),
        (["--actor-lr", "nan"], "finite"),
        (["--latency", "0.2,0.1"], "--latency"),
        (["--latency", "100"], "--latency is '100': give a number from 0 to 2"),
        (["--actors", "1", "--ray-address", "127.0.0.1:1"], "no Ray answers at 127.0.0.1:1"),
        (["--pool", "threads"], "invalid choice"),
        (["--planner-frequency", "40"], "--planner-frequency is 40: give 0 to 20"),
        (["--mix"], "--mix needs"),
        (["--simulator", "gazebo"], "--simulator is 'gazebo': give pybullet or kinematic, or MODULE:CLASS"),
        (["--worlds", "generated:900"], "generated:900"),
        (["--env", "nowhere:Nothing"], "nowhere"),
        (["--resume", "--out", "/nowhere/at/all"], "holds no run"),
        (["--device", "quantum"], "device 'quantum' is unknown"),
        (["--out", "/proc/nowhere"], "cannot be made"),
        (["--dataset", "/nowhere"], "no dataset"),
    ],
)
def test_bad_options_are_one_line(arguments, pattern, tmp_path, capsys):
    given = [] if "--worlds" in arguments or "--env" in arguments else ["--env", "tests.toy_env:Line"]
    where = [] if "--out" in arguments else ["--out", tmp_path / "run"]
    status = (
        1
        if any(a in arguments for a in ("--worlds", "--device", "--out", "--dataset", "--ray-address"))
        and "--resume" not in arguments
        else 2
    )
    one_line(capsys, [*given, *where, *arguments], status, pattern)
    for name in ("checkpoint.json", "config.json"):  # the right command may use the same folder
        assert not (tmp_path / "run" / name).exists()


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--critics", "9"], "critics is 9: give 2, or up to as many as actions"),
        (["--symmetric"], "no scan and angle to mirror"),
        (["--scan-pool", "7"], "scan_pool is 7: give a divisor"),
    ],
)
def test_networks_that_cannot_be_built_leave_no_folder(arguments, pattern, tmp_path, capsys):
    given = ["--env", "tests.toy_env:Line", "--out", tmp_path / "run", "--device", "cpu"]
    one_line(capsys, [*given, *arguments], 1, pattern)
    assert not (tmp_path / "run").exists()


def test_a_run_is_not_overwritten_and_not_mixed_up(whole, tmp_path, capsys):
    before = state_of(whole)
    one_line(capsys, toy(whole), 2, "holds a run already: --resume")
    one_line(capsys, ["--resume", "--out", whole, "--hidden", "64"], 2, "--hidden 64: .* cannot be changed")
    lock = TrainingRun(parse(toy(tmp_path / "busy", "--steps", "10"))).lock
    one_line(capsys, ["--resume", "--out", tmp_path / "busy"], 1, "another train.py works")
    lock.close()
    stored = json.loads((whole / "config.json").read_text())
    for change, pattern in (
        ({"colour": 1}, "unknown option 'colour'"),
        ({"steps": "x"}, 'steps is "x"; give a whole number'),
    ):
        other = tmp_path / ("stored%d" % len(pattern))
        other.mkdir()
        (other / "config.json").write_text(json.dumps({**stored, **change}))
        one_line(capsys, ["--resume", "--out", other], 2, pattern)
    assert state_of(whole) == before


def test_damaged_checkpoints_are_refused(whole, tmp_path, capsys):
    for name, damage, pattern in (
        ("checkpoint.json", lambda p: p.write_bytes(p.read_bytes()[:100]), "not JSON"),
        ("checkpoint.json", lambda p: p.write_bytes(b""), "not JSON"),
        ("learner", lambda p: p.write_bytes(p.read_bytes()[:-9] + b"damaged!!"), "checksum"),
        ("learner", lambda p: p.unlink(), "cannot be read"),
        ("config.json", lambda p: p.write_bytes(b""), "not JSON"),
        ("journal/000000.segment", lambda p: p.write_bytes(p.read_bytes()[:2000]), "missing or damaged"),
    ):
        copy = tmp_path / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(whole, copy)
        damage(copy / name if name != "learner" else next(copy.glob("learner-*.safetensors")))
        one_line(capsys, ["--resume", "--out", copy, "--steps", "900"], 1, pattern)


def test_a_full_disk_leaves_the_last_checkpoint(whole, tmp_path, monkeypatch, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(whole, copy)
    before, real = state_of(copy), os.fsync

    def full(descriptor):
        if "learner" in os.readlink("/proc/self/fd/%d" % descriptor):
            raise OSError(28, "No space left on device")
        return real(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    one_line(capsys, ["--resume", "--out", copy, "--steps", "900"], 1, "No space left")
    monkeypatch.undo()
    assert state_of(copy) == before
    assert not list(copy.glob("*.partial"))
    assert main(["--resume", "--out", str(copy), "--steps", "900"]) == 0


def test_datasets_with_faults_are_refused(tmp_path, capsys):
    layout, rng = Layout(0, 1, 1), np.random.default_rng(0)
    writer = Writer(tmp_path / "data", layout)
    for i in range(5):
        writer.add(
            Trajectory.of(
                layout,
                rng.uniform(-1, 1, (4, 1)),
                rng.uniform(-1, 1, (3, 1)),
                rng.normal(size=3),
                i % 2 == 0,
                {"actor": "x", "episode": i},
            )
        )
    writer.skip("truncated bag")
    manifest = writer.close()
    assert manifest["transitions"] == 15
    assert manifest["skipped"] == {"truncated bag": 1}
    back = list(Dataset(tmp_path / "data", layout))
    assert [t.terminated for t in back] == [True, False, True, False, True]
    assert back[3].info["episode"] == 3
    with pytest.raises(DatasetError, match="layout"):
        Dataset(tmp_path / "data", Layout())
    run = toy(tmp_path / "run", "--dataset", tmp_path / "data")
    shard = tmp_path / "data" / manifest["shards"][0]["file"]
    good = shard.read_bytes()
    shard.write_bytes(good[:-1] + b"x")
    one_line(capsys, run, 1, "shard-00000.npz: checksum is wrong")
    import hashlib
    import io

    arrays = dict(np.load(io.BytesIO(good)))
    arrays["reward"][2] = np.nan
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    shard.write_bytes(buffer.getvalue())
    manifest["shards"][0]["sha256"] = hashlib.sha256(buffer.getvalue()).hexdigest()
    (tmp_path / "data" / "manifest.json").write_text(json.dumps(manifest))
    one_line(capsys, toy(tmp_path / "run2", "--dataset", tmp_path / "data"), 1, "episode 0: reward holds NaN")


def test_an_environment_that_always_fails_ends_the_run_in_one_line(tmp_path, capsys):
    arguments = toy(tmp_path / "run", "--eval-worlds", "none")
    arguments[1] = "tests.toy_env:Broken"
    assert main(arguments) == 1
    assert "20 episodes in a row failed, the last with RuntimeError: the wheels came off" in capsys.readouterr().err


def test_another_simulator_begins_anew_with_default_and_best(tmp_path):
    """Its times are no rivals of the first one's."""

    def drive(rounds, step, seconds):
        for number in iter(lambda: rounds.due(step), None):
            for trial in rounds.begin(number, step, step):
                touched = trial.world == "w1"
                result = TrialResult(seconds < 100, touched, False, seconds, decisions=5, total_reward=-seconds)
                summary = rounds.add(Answer(trial, result=result))
            yield summary

    first = PeriodicEvaluation(
        tmp_path, [("w0", "w0"), ("w1", "w1")], 2, 100, 0, contact_seconds=4.0, setting="kinematic"
    )
    assert [s["round"] for s in drive(first, 0, 20.0)] == [-1]
    (summary,) = drive(first, 130, 10.0)
    assert summary["round"] == 1
    assert summary["score"] == 12.0
    assert summary["best"]
    assert [s["best"] for s in drive(first, 210, 11.0)] == [False]
    again = PeriodicEvaluation(
        tmp_path, [("w0", "w0"), ("w1", "w1")], 2, 100, 0, contact_seconds=4.0, setting="kinematic"
    )
    assert again.best["step"] == 130
    assert again.default["time_s"] == 20.0
    assert again.due(299) is None
    again.every = 150  # changed at a --resume: the rounds so far were counted otherwise
    assert [again.due(step) for step in (299, 300)] == [None, 2]
    other = PeriodicEvaluation(
        tmp_path, [("w0", "w0"), ("w1", "w1")], 2, 100, 0, contact_seconds=4.0, setting="pybullet"
    )
    summaries = list(drive(other, 310, 100.0))
    assert [(s["round"], s["best"]) for s in summaries] == [(-1, False), (3, True)]
    assert summaries[1]["time_s"] is None
    assert summaries[1]["score"] == 102.0
    more = PeriodicEvaluation(tmp_path, [("w0", "w0"), ("w1", "w1")], 3, 100, 0, 4.0, setting="kinematic")
    assert more.best is None  # nor are rounds of another number of trials; those that do not say it are
    rounds = [{k: v for k, v in r.items() if k != "trials_per_world"} for r in more.history]
    more.path.write_text("".join(json.dumps(r) + "\n" for r in rounds))
    older = PeriodicEvaluation(tmp_path, [("w0", "w0"), ("w1", "w1")], 3, 100, 0, 4.0, setting="kinematic")
    assert older.best["step"] == 130


def test_help_names_every_option_and_noise_is_the_papers():
    text = options.parser().format_help()
    for name in TrainConfig.__dataclass_fields__:
        assert "--" + name.replace("_", "-") in text
    paper = TrainConfig().resolved()
    assert paper.noise(0) == 0.5
    assert paper.noise(1_000_000) == pytest.approx(0.375)
    assert paper.noise(3_840_000) == pytest.approx(0.02)
    assert paper.noise(5_000_000) == 0.02
    assert TrainConfig(steps=50_000).resolved().noise(38_400) == pytest.approx(0.02)
    with pytest.raises(ConfigError):
        TrainConfig(actors=-1)
    assert parse(["--simulator", "my_module:Mine"]).evaluation()["simulator"] == "my_module:Mine"


@pytest.mark.parametrize(("most", "left"), [(float("inf"), "0:01:40"), (12.3, "0:00:12"), (-1.0, "0:00:00")])
def test_a_training_says_how_much_time_is_left_by_its_steps_and_by_its_minutes(most, left):
    rates = {"transitions_per_second": 5.0, "updates_per_second": 1.0}
    means = dict.fromkeys(("sigma", "return", "length", "success", "collided", "staleness_mean"), 0.0)
    values = {**rates, **means, "staleness_max": 3, "actors": 2, "replaced": 0, "refused": 1}
    line = status("transitions", 500, 1000, values, most)
    assert line.startswith("500 of 1,000 transitions  5.0 transitions/s")
    assert line.endswith("actors 2  refused 1  %s left" % left)
