"""The workers: both kinds learn, dead ones are replaced, Ray's nodes may go, the learner takes in what they send."""

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import safetensors.numpy

from applr_ros1.common.errors import ApplrError
from tests.support import HANGS
from tests.support.processes import is_alive
from tests.support.toy_training import LINE, main
from tests.support.toy_training import toy_settings as settings
from training.actors import local
from training.actors.collector import Collector
from training.actors.local import ROOT
from training.actors.pool import make_pool
from training.actors.ray import start_ray
from training.actors.scheduler import TaskScheduler
from training.actors.tasks import POLICY, Answer, Collect, RunnerSpec, Trial, TrialResult, WorkerSettings
from training.learner.learner import Learner, LearnerOptions
from training.replay.trajectory import Trajectory, TransitionLayout
from training.td3.td3 import TD3, TD3Options

LAYOUT = TransitionLayout(0, 1, 1)
SMALL = ["--net-arch=16", "--batch-size=16", "--actors=2", "--device=cpu"]


TOY, SLOW = settings(LINE), settings("tests.support.toy_env:Slow")


def scheduler(**options):
    made = TaskScheduler(options.pop("seed", 0), None, lambda transitions: 0.5, **options)
    made.ready = True
    return made


def trial(number, method="dwa"):
    return Trial("w", method, number, number, "", POLICY if method == "policy" else method, "ours")


def weights(seed=0, units=(8,)):
    return safetensors.numpy.save(TD3(1, 1, TD3Options(net_arch=list(units)), seed=seed).actor_weights())


def collect(pool, seconds, enough=lambda answers: False):
    answers, end = [], time.monotonic() + seconds
    while time.monotonic() < end and not enough(answers):
        answers += pool.poll(0.2)
    return answers


def test_exploration_noise_has_the_tasks_standard_deviation():
    runner = Collector("tests.support.toy_env:Line", {})
    for sigma in (0.0, 0.1):
        tasks = [Collect("a", episode, 0, sigma, False) for episode in range(40)]
        answers = [runner.run(task, lambda observation: np.zeros(1, np.float32)) for task in tasks]
        actions = np.concatenate([Trajectory.unpack(answer.data, LAYOUT).action[:, 0] for answer in answers])
        assert 0.9 * sigma <= actions.std() <= 1.1 * sigma


def trajectories(answers):
    assert not any(answer.error for answer in answers), answers
    return [Trajectory.unpack(answer.data, LAYOUT) for answer in answers]


def test_in_process_is_the_same_every_time_and_pulls_the_newest_policy():
    runs = []
    for _ in range(2):
        pool = make_pool(TOY, scheduler(seed=3).next_task, 0)
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
    pool = make_pool(TOY, scheduler().next_task, 2)
    try:
        pool.publish(0, weights())
        both = {"actor-0", "actor-1"}
        got = trajectories(collect(pool, 30, lambda a: len(a) > 40 and {each.task.actor for each in a} == both))
        pids = [link.process.pid for link in pool.links]
    finally:
        begun = time.monotonic()
        pool.close()
    assert time.monotonic() - begun < 5
    assert not any(map(is_alive, pids))
    keys = [(t.info["actor"], t.info["episode"]) for t in got]
    assert len(keys) == len(set(keys)) > 40
    assert {a for a, _ in keys} == {"actor-0", "actor-1"}


SLOW_START = "import sys, time\nif 'training.actors.worker' in sys.orig_argv:\n    time.sleep(2.5)\n"


def test_a_worker_that_starts_slowly_gets_a_policy_larger_than_the_socket_holds(tmp_path, monkeypatch):
    """Its first message waits unread for longer than a message may stop in the middle."""
    (tmp_path / "sitecustomize.py").write_text(SLOW_START)
    monkeypatch.syspath_prepend(tmp_path)  # a worker's path begins with this one's
    monkeypatch.setattr(local, "HALF_A_MESSAGE", 1)
    large = weights(units=(512, 512))
    assert len(large) > 500_000  # Linux's buffers hold some 200 kB
    tasks = scheduler()
    tasks.ready = False  # no task before there is a policy
    pool = make_pool(TOY, tasks.next_task, 1)
    try:
        pool.publish(0, large)
        tasks.ready = True
        assert trajectories(collect(pool, 30, lambda answers: len(answers) >= 2))
        assert pool.replaced == 0
    finally:
        pool.close()


@pytest.mark.fault("20")
def test_a_killed_and_a_stopped_process_are_replaced():
    pool = make_pool(SLOW, scheduler().next_task, 2, task_seconds=3.0)
    try:
        pool.publish(0, weights())
        assert collect(pool, 30, lambda answers: len(answers) >= 4)
        pool.links[0].process.send_signal(signal.SIGKILL)
        pool.links[1].process.send_signal(signal.SIGSTOP)
        assert len(trajectories(collect(pool, 30, lambda a: pool.replaced >= 2 and len(a) > 6))) > 6
        assert pool.replaced >= 2
        assert pool.alive == 2
    finally:
        pool.close()


def test_actors_end_when_the_learner_is_killed(tmp_path):
    """SIGKILL to the learner: its processes notice within seconds, by their closed sockets."""
    code = (
        "import sys, time; from tests.training.actors.test_workers import *\n"
        "pool = make_pool(TOY, scheduler().next_task, 2)\n"
        "pool.publish(0, weights()); collect(pool, 20, lambda a: len(a) > 3)\n"
        "print(*[link.process.pid for link in pool.links], flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    pids = [int(word) for word in process.stdout.readline().split()]
    process.kill()
    process.wait()
    end = time.monotonic() + 5
    while time.monotonic() < end and any(map(is_alive, pids)):
        time.sleep(0.05)
    assert len(pids) == 2
    assert not any(map(is_alive, pids))


def test_actors_that_all_die_end_the_run_in_one_line():
    pool = make_pool(settings("os:abort"), scheduler().next_task, 2)
    try:
        pool.publish(0, weights())
        with pytest.raises(ApplrError, match="workers died one after the other"):
            collect(pool, 60)
    finally:
        pool.close()


def test_training_with_processes_some_of_which_die(tmp_path, capsys):
    out = tmp_path / "run"
    options, env = ["--total-timesteps=1500", "--eval-worlds=none"], "tests.support.toy_env:Dying"
    assert main([*SMALL, *options, "--out", str(out)], env) == 0
    saved = Learner.saved(out)
    assert saved["transitions"] >= 1500
    assert saved["updates"] == saved["transitions"] // 10
    assert "died; a new one takes its place" in capsys.readouterr().err
    assert main(["--resume", "--out", str(out), "--total-timesteps", "1700"], env) == 0  # new episodes
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


@pytest.mark.fault("20")
def test_the_learner_refuses_and_counts_what_is_wrong_and_goes_on(tmp_path):
    options = LearnerOptions(net_arch=[8], batch_size=8, buffer_size=1000, utd_ratio=1.0, device="cpu")
    learner = Learner(LAYOUT, options, tmp_path)
    broken = trajectory(3)
    broken.reward[1] = np.nan
    import pickle

    nonsense = b"", b"nonsense" * 20, broken.pack(), pickle.dumps([1])
    late = trajectory(5, version=9), trajectory(6, version="new")
    good = trajectory(1), trajectory(1), trajectory(2)
    one, again, two, new, odd = (each.pack() for each in (*good, *late))
    for blob in (one, again, *nonsense, two, new, odd):
        learner.take(blob)
        learner.train()
    assert learner.transitions == 30
    assert learner.td3.updates == 30
    reasons = " | ".join(learner.refused)
    words = "came twice", "truncated", "not a safetensors file", "NaN", "not a whole number"
    assert all(part in reasons for part in words), reasons
    assert (len(learner.lags), max(learner.lags)) == (3, 11)


class Driver:
    """A runner of trials: number 3 ends its process each time, number 4 fails, the rest tell what they drove."""

    def __init__(self, **options):
        pass

    def run(self, task, policy):
        import os

        if task.trial == 3:
            os._exit(9)
        if task.trial == 4:
            raise ValueError("this trial cannot be driven")
        return Answer(task, result=TrialResult(total_reward=0.0 if policy is None else float(policy(np.ones(1))[0])))


@pytest.mark.parametrize("workers", [0, 2])
def test_every_trial_has_one_answer_and_pinned_trials_the_pinned_policy(workers):
    """A trial whose worker dies is given again, and in the end answered by an error; the others do not suffer."""
    from training.actors.worker import PolicyWeights

    todo = [trial(i, "policy") for i in range(12) if workers or i != 3]
    queue = list(todo)
    mine = WorkerSettings(trial=RunnerSpec("tests.training.actors.test_workers:Driver", {}))
    pool = make_pool(mine, lambda slot: queue.pop(0) if queue else None, workers)
    pool.publish(9, weights(9))
    pool.pin_for_evaluation(5, weights(5))
    try:
        answers = collect(pool, 60, lambda answers: len(answers) >= len(todo))
        assert pool.poll(0.0) == []
    finally:
        pool.close()
    by_trial = {answer.task: answer for answer in answers}
    assert len(answers) == len(by_trial) == len(todo)
    assert "cannot be driven" in by_trial.pop(trial(4, "policy")).error
    if workers:
        assert "its worker died 3 times" in by_trial.pop(trial(3, "policy")).error
        assert pool.replaced >= 3
    expected = float(PolicyWeights(weights(5))(np.ones(1))[0])
    assert {answer.result.total_reward for answer in by_trial.values()} <= {expected, 0.0}
    assert expected in {answer.result.total_reward for answer in by_trial.values()}


def test_a_search_has_idle_workers_and_no_errors():
    """Two sets in one world for three workers: the third waits in silence, and each set has its score."""
    pytest.importorskip("cma")
    from applr_ros1.policy.parameter_space import SPACE
    from training.evaluation.remembered import RememberedTrials
    from training.static_search import SetTrials

    drives = RememberedTrials(RunnerSpec("tests.training.actors.test_workers:Driver", {}), workers=3)
    trials = SetTrials(drives, [("w", "w")], SPACE)
    try:
        found = trials.run(np.array([SPACE.low, SPACE.high]), [(0, 0)], seed=0)
        assert [len(results) for results in found] == [1, 1]
        assert trials.driven == 2
        time.sleep(0.3)
        assert drives.pool.poll(0.0) == []
        assert drives.pool.replaced == 0
    finally:
        drives.close()


def test_an_unreachable_ray_address_is_one_line_soon():
    begun = time.monotonic()
    for address in ("127.0.0.1:1", "nowhere", "ray://127.0.0.1:1"):
        with pytest.raises(ApplrError, match="no Ray answers at"):
            start_ray(address, 1)
    assert time.monotonic() - begun < 15


LISTENS = """
import os
from training.actors.ray import start_ray

ray = start_ray("local", 1)
session = os.path.basename(ray._private.worker._global_node.get_session_dir_path())
mine = set()
for pid in filter(str.isdigit, os.listdir("/proc")):
    try:
        if int(pid) == os.getpid() or session in open("/proc/%s/cmdline" % pid).read():
            mine |= {os.readlink(entry.path)[8:-1] for entry in os.scandir("/proc/%s/fd" % pid)}
    except OSError:
        continue  # it has ended
rows = [line.split() for name in ("tcp", "tcp6") for line in list(open("/proc/net/" + name))[1:]]
print(*{row[1].split(":")[0] for row in rows if row[3] == "0A" and row[9] in mine})
ray.shutdown()
"""


@pytest.mark.fault("20b")
def test_ray_on_this_machine_listens_on_loopback_only():
    pytest.importorskip("ray")
    done = subprocess.run([sys.executable, "-c", LISTENS], cwd=ROOT, capture_output=True, text=True, timeout=HANGS)
    addresses = done.stdout.splitlines()[-1].split()  # as /proc/net writes 127.0.0.1, and that in IPv6
    assert addresses, done.stderr
    assert set(addresses) <= {"0100007F", "0000000000000000FFFF00000100007F"}


def test_a_ray_address_that_nothing_would_run_at_is_refused():
    with pytest.raises(ApplrError, match="--ray-address 127.0.0.1:1: nothing would run there"):
        make_pool(TOY, lambda slot: None, 0, "127.0.0.1:1")


@pytest.mark.slow
def test_training_on_ray_nodes_one_of_which_is_killed(tmp_path):
    """Three nodes on this machine; one goes in the middle of the training, which goes on, and says that two drive."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        victim = cluster.add_node(num_cpus=1, include_dashboard=False)
        cluster.add_node(num_cpus=1, include_dashboard=False)
        pool = make_pool(SLOW, scheduler().next_task, 3, cluster.address)
        try:
            pool.publish(0, weights())
            assert len(trajectories(collect(pool, 40, lambda a: len(a) >= 9 and pool.alive == 3))) >= 9
            assert pool.alive == 3
            remover = threading.Thread(target=cluster.remove_node, args=(victim,))
            remover.start()
            after = trajectories(collect(pool, 40, lambda a: pool.replaced >= 1 and len(a) >= 30))
            remover.join(30)
            assert pool.replaced >= 1
            assert len(after) >= 30
            assert pool.alive == 2, "the third waits for a place"
        finally:
            pool.close()
    finally:
        cluster.shutdown()
