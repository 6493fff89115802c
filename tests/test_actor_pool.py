"""The actors: both kinds learn, dead ones are replaced, Ray's nodes may go, and the learner takes in what they send."""

import signal
import threading
import time

import numpy as np
import pytest

from training.experience.trajectory import Layout, Trajectory
from training.gorila import actor_pool
from training.gorila.actor_pool import InProcess, PoolError, Processes, RayPool, start_ray
from training.gorila.config import TrainConfig
from training.gorila.learner import Learner, LearnerConfig
from training.gorila.tasks import Tasks, easiest_first
from training.td3.td3 import TD3Config
from training.train import main

TOY = {"env": "tests.toy_env:Line", "train": {}, "evaluate": {}}
SLOW = dict(TOY, env="tests.toy_env:Slow")
LAYOUT = Layout(0, 1, 1)


def tasks(**options):
    return Tasks(TrainConfig(env="tests.toy_env:Line", **options).resolved(), None)


def weights(seed=0):
    import safetensors.numpy

    from training.td3.td3 import TD3

    return safetensors.numpy.save(TD3(1, 1, TD3Config(hidden=(8,)), seed=seed).actor_weights())


def collect(pool, seconds, enough=lambda answers: False):
    answers, end = [], time.monotonic() + seconds
    while time.monotonic() < end and not enough(answers):
        answers += pool.poll(0.2)
    return answers


def trajectories(answers):
    assert all(a[:1] == b"T" for a in answers), [a for a in answers if a[:1] != b"T"][:1]
    return [Trajectory.unpack(a[1:]) for a in answers]


def gone(pid):
    try:
        with open("/proc/%d/stat" % pid) as file:
            return file.read().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def test_in_process_is_the_same_every_time_and_pulls_the_newest_policy():
    runs = []
    for _ in range(2):
        pool = InProcess(TOY, tasks(seed=3).next)
        pool.publish(0, weights(0))
        answers = pool.poll(0)
        pool.publish(7, weights(1))
        runs.append(trajectories(answers + pool.poll(0)))
    assert [t.info["version"] for t in runs[0]] == [0, 7]
    assert [t.info["episode"] for t in runs[0]] == [0, 1]
    for a, b in zip(*runs):
        assert np.array_equal(a.action, b.action)
        assert a.info == b.info
    assert not np.array_equal(runs[0][0].action, runs[0][1].action)


def test_processes_deliver_each_episode_once_and_are_gone_after():
    pool = Processes(TOY, tasks().next, 2)
    try:
        pool.publish(0, weights())
        got = trajectories(
            collect(
                pool,
                30,
                lambda answers: len(answers) > 40 and all(any(b"actor-%d" % i in a for a in answers) for i in (0, 1)),
            )
        )
        pids = [slot.actor.pid for slot in pool._slots]
    finally:
        begun = time.monotonic()
        pool.close()
    assert time.monotonic() - begun < 5
    assert all(gone(pid) for pid in pids)
    keys = [(t.info["actor"], t.info["episode"]) for t in got]
    assert len(keys) == len(set(keys)) > 40
    assert {a for a, _ in keys} == {"actor-0", "actor-1"}


def test_a_killed_and_a_stopped_process_are_replaced():
    pool = Processes(SLOW, tasks().next, 2, task_seconds=3.0)
    try:
        pool.publish(0, weights())
        assert collect(pool, 30, lambda answers: len(answers) >= 4)
        pool._slots[0].actor.send_signal(signal.SIGKILL)
        pool._slots[1].actor.send_signal(signal.SIGSTOP)
        assert len(trajectories(collect(pool, 30, lambda a: pool.replaced >= 2 and len(a) > 6))) > 6
        assert pool.replaced >= 2
        assert pool.alive == 2
    finally:
        pool.close()


def test_actors_end_when_the_learner_is_killed(tmp_path):
    """SIGKILL to the learner: its processes notice within seconds, by their closed sockets."""
    import subprocess
    import sys

    code = (
        "import sys, time; from tests.test_actor_pool import *; pool = Processes(TOY, tasks().next, 2)\n"
        "pool.publish(0, weights()); collect(pool, 20, lambda a: len(a) > 3)\n"
        "print(*[slot.actor.pid for slot in pool._slots], flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=actor_pool.ROOT)
    pids = [int(word) for word in process.stdout.readline().split()]
    process.kill()
    process.wait()
    end = time.monotonic() + 5
    while time.monotonic() < end and not all(gone(pid) for pid in pids):
        time.sleep(0.05)
    assert len(pids) == 2
    assert all(gone(pid) for pid in pids)


def test_actors_that_all_die_end_the_run_in_one_line():
    settings = dict(TOY, env="os:abort")  # ends its process at the first task
    pool = Processes(settings, tasks().next, 2)
    try:
        pool.publish(0, weights())
        with pytest.raises(PoolError, match="actors died one after the other"):
            collect(pool, 60)
    finally:
        pool.close()


def test_training_with_processes_some_of_which_die(tmp_path, capsys):
    out = tmp_path / "run"
    assert (
        main(
            [
                "--env",
                "tests.toy_env:Dying",
                "--out",
                str(out),
                "--hidden",
                "16",
                "--batch-size",
                "16",
                "--steps",
                "1500",
                "--actors",
                "2",
                "--pool",
                "processes",
                "--no-tensorboard",
                "--eval-worlds",
                "none",
                "--device",
                "cpu",
            ]
        )
        == 0
    )
    saved = Learner.saved(out)
    assert saved["transitions"] >= 1500
    assert saved["updates"] == saved["transitions"] // 10
    assert "died; a new one takes its place" in capsys.readouterr().err
    assert main(["--resume", "--out", str(out), "--steps", "1700"]) == 0  # another incarnation, new episodes
    assert Learner.saved(out)["transitions"] >= 1700


def trajectory(number, version=0, **change):
    rng = np.random.default_rng(number)
    return Trajectory.of(
        LAYOUT,
        rng.uniform(-1, 1, (11, 1)),
        rng.uniform(-1, 1, (10, 1)),
        rng.normal(size=10),
        False,
        dict({"actor": "a", "episode": number, "version": version}, **change),
    )


def test_the_learner_refuses_and_counts_what_is_wrong_and_goes_on():
    learner = Learner(LAYOUT, LearnerConfig(TD3Config(hidden=(8,), batch_size=8), 1000, 1.0, max_staleness=15))
    broken = trajectory(3)
    broken.reward[1] = np.nan
    import pickle

    for blob in (
        trajectory(1).pack(),
        trajectory(1).pack(),
        b"",
        b"nonsense" * 20,
        broken.pack(),
        pickle.dumps([1]),
        trajectory(2).pack(),
        trajectory(4, version=0).pack(),
        trajectory(5, version=9).pack(),
        trajectory(6, version="new").pack(),
    ):
        learner.take(blob)
        learner.train()
    assert learner.transitions == 30
    assert learner.td3.updates == 30
    reasons = " | ".join(learner.refused)
    for part in ("came twice", "damaged", "NaN", "more than 15 updates old", "is no number"):
        assert part in reasons
    assert learner.staleness.most == 11
    assert learner.staleness.count == 3


def test_a_learner_without_a_folder_saves_nothing_and_goes_on():
    learner = Learner(LAYOUT, LearnerConfig(TD3Config(hidden=(8,), batch_size=8), 1000, 1.0))
    learner.take(trajectory(1).pack())
    learner.save({"elapsed": 1.0})
    assert learner.resume() == {}
    assert learner.train() == 10


def test_curriculum_opens_from_the_easiest_quarter_to_all():
    config = TrainConfig(steps=1000, curriculum=0.5).resolved()
    order = np.arange(40)[::-1]
    t = Tasks(config, 40, order)
    first = {t.next(0)["world"] for _ in range(300)}
    assert first == set(range(30, 40))
    t.transitions = 500
    assert {t.next(0)["world"] for _ in range(2000)} == set(range(40))


def test_easiest_world_first():
    worlds = pytest.importorskip("worlds")
    few = [worlds.load("generated:%d" % i) for i in (0, 80, 160, 299)]
    order = easiest_first(few)
    assert sorted(order) == [0, 1, 2, 3]
    assert order[0] == 0
    assert order[-1] in (2, 3)


def test_evaluations_go_first_and_lost_trials_are_given_again(monkeypatch):
    t = tasks()
    trials = [{"kind": "evaluate", "round": 1, "world": w, "trial": 0, "seed": 0} for w in range(2)]
    t.evaluate(trials)
    assert [t.next(i)["kind"] for i in range(3)] == ["evaluate", "evaluate", "train"]
    assert t.done(trials[0])
    assert not t.done(trials[0])
    now = time.monotonic()
    monkeypatch.setattr("training.gorila.tasks.time.monotonic", lambda: now + 1000)
    again = t.next(0)
    assert again == trials[1]
    assert t.next(0)["kind"] == "train"


def test_an_unreachable_ray_address_is_one_line_soon():
    begun = time.monotonic()
    for address in ("127.0.0.1:1", "nowhere", "ray://127.0.0.1:1"):
        with pytest.raises(PoolError, match="no Ray answers at"):
            start_ray(address, 1)
    assert time.monotonic() - begun < 15


@pytest.mark.slow
def test_training_on_ray_nodes_one_of_which_is_killed(tmp_path):
    """Three nodes on this machine; one goes in the middle of the training, which goes on and ends."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        victim = cluster.add_node(num_cpus=1, include_dashboard=False)
        cluster.add_node(num_cpus=1, include_dashboard=False)
        pool = RayPool(SLOW, tasks().next, 3, cluster.address)
        try:
            pool.publish(0, weights())
            assert len(trajectories(collect(pool, 40, lambda a: len(a) >= 9))) >= 9
            remover = threading.Thread(target=cluster.remove_node, args=(victim,))
            remover.start()
            after = trajectories(collect(pool, 40, lambda a: pool.replaced >= 1 and len(a) >= 30))
            remover.join(30)
            assert pool.replaced >= 1
            assert len(after) >= 30
        finally:
            pool.close()
    finally:
        cluster.shutdown()


@pytest.mark.slow
def test_training_on_local_ray(tmp_path):
    pytest.importorskip("ray")
    out = tmp_path / "run"
    assert (
        main(
            [
                "--env",
                "tests.toy_env:Line",
                "--out",
                str(out),
                "--hidden",
                "16",
                "--batch-size",
                "16",
                "--steps",
                "600",
                "--actors",
                "2",
                "--no-tensorboard",
                "--eval-every",
                "300",
                "--device",
                "cpu",
            ]
        )
        == 0
    )
    assert Learner.saved(out)["transitions"] >= 600
    assert len((out / "evaluations.jsonl").read_text().splitlines()) >= 2
