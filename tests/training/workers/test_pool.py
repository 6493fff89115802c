"""Tests of the pool of workers: child processes, Ray, dead workers, trainings that lose workers."""

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import numpy as np
import pytest
import safetensors.numpy

from applr_ros1.common.errors import ApplrError
from tests.support import ROOT, is_alive
from tests.support.runs import main, toy_run
from tests.support.training import Dying, Line, Slow, answer
from training.env.trajectory import TransitionLayout
from training.train.learner.config import parse
from training.train.learner.learner import Learner
from training.train.td3.td3 import TD3, TD3Options
from training.workers.calls import CallFailed
from training.workers.collect import Collect, collect
from training.workers.pool import Pool
from training.workers.ray import connect

LAYOUT = TransitionLayout(0, 1, 1)
SMALL = ["--net-arch=16", "--batch-size=16", "--actors=2"]


def weights_of_a_still_robot():
    """Return the weights of a network whose actions are all 0, as the bytes of a file."""
    weights = TD3(1, 1, TD3Options(net_arch=[8]), seed=0).actor_weights()
    for layer_name, layer_weights in weights.items():
        weights[layer_name] = np.zeros_like(layer_weights)
    return safetensors.numpy.save(weights)


def results(pool, numbers, seconds=0.0):
    """Return {number: (number, process id), or the error of its call}."""
    answers = {}
    for number, future in pool.unordered(partial(answer, seconds=seconds), numbers):
        error = future.exception()
        if error:
            answers[number] = str(error)
        else:
            answers[number] = future.result()
    return answers


@pytest.mark.parametrize("sigma", [0.0, 0.1])
def test_an_episode_depends_only_on_run_and_number_and_noise_has_its_deviation(sigma):
    weights = weights_of_a_still_robot()

    def drive(episode):
        """Return the trajectory of an episode."""
        task = Collect(episode, 0, sigma, False)
        return collect(Line, "{}", task, weights)

    trajectories = list(map(drive, range(40)))
    # Driven again after others, as another worker would drive it.
    repeated = drive(3)
    assert np.array_equal(repeated.action, trajectories[3].action)
    assert np.array_equal(repeated.rest, trajectories[3].rest)
    # The policy's own actions are 0, so that noise alone deviates from it.
    actions = np.concatenate([trajectory.action for trajectory in trajectories])
    assert 0.9 * sigma <= actions.std() <= 1.1 * sigma


def test_explored_actions_stay_within_their_range():
    task = Collect(episode=0, seed=0, sigma=2.0, random=False)
    trajectory = collect(Line, "{}", task, weights_of_a_still_robot())
    # Most of this noise is beyond the range, on either side.
    assert trajectory.action.min() == -1.0
    assert trajectory.action.max() == 1.0


@pytest.mark.parametrize("workers", [0, 2])
def test_every_call_has_one_answer(workers):
    """A call whose worker dies is repeated, and fails after several deaths."""
    numbers = list(range(12))
    if not workers:
        numbers.remove(3)  # The call 3 would end this process.
    with Pool(workers) as pool:
        answers = results(pool, numbers)

    # Call 4 raises an error, which costs no worker. Call 3 ends each worker that takes it.
    assert answers.pop(4) == "this trial cannot be driven"
    if workers:
        assert "its worker died 3 times" in answers.pop(3)
        assert pool.replaced == 3
    for number, (answered_number, pid) in answers.items():
        assert answered_number == number
        assert (pid == os.getpid()) == (workers == 0)


def test_shutdown_ends_busy_processes():
    futures = []
    with Pool(2) as pool:
        pids = [worker.process.pid for worker in pool.workers]
        # Two of these calls run after a second, the others wait.
        for _ in range(5):
            futures.append(pool.submit(time.sleep, 60))
        time.sleep(1.0)
        began = time.monotonic()
    # Far less than the 60 s that the calls would sleep.
    assert time.monotonic() - began < 50
    for future in futures:
        assert future.cancelled() or isinstance(future.exception(), CallFailed)
    assert not any(map(is_alive, pids))


# Code that Python runs at its start, and that keeps a worker from reading for a while
SLOW_START = "import sys, time\nif 'workers.pool' in str(sys.orig_argv):\n    time.sleep(1.5)\n"


def test_a_worker_that_starts_slowly_gets_arguments_larger_than_the_socket_holds(
    tmp_path, monkeypatch
):
    (tmp_path / "sitecustomize.py").write_text(SLOW_START)
    monkeypatch.syspath_prepend(tmp_path)  # Workers inherit this module search path.
    # A socket holds some hundred kB, so that sending waits until the worker reads.
    large_argument = bytes(3_000_000)
    with Pool(1) as pool:
        assert pool.submit(len, large_argument).result(30) == 3_000_000
        assert pool.replaced == 0

    # A message that is never read does not block the shutdown.
    with Pool(1) as pool:
        future = pool.submit(len, large_argument)
        began = time.monotonic()
    # far below the 900 s after which a worker counts as hung
    assert time.monotonic() - began < 50
    assert future.exception()


@pytest.mark.fault("20")
def test_a_killed_and_a_stopped_process_are_replaced():
    with Pool(2, seconds=10.0) as pool:
        # Calls 3 and 4 are the ones that fail. These here have answers, and show that both live.
        assert len(results(pool, range(5, 9))) == 4
        killed_worker, stopped_worker = pool.workers

        def numbers():
            """Yield numbers of calls; when one has just begun, kill a process, and stop another."""
            yield from range(5, 8)
            killed_worker.process.kill()
            # A stopped process keeps its socket open: only its time is up.
            stopped_worker.process.send_signal(signal.SIGSTOP)
            yield from range(8, 13)

        answers = results(pool, numbers(), seconds=0.3)
        assert set(answers) == set(range(5, 13))
        for number, (answered_number, _) in answers.items():
            assert answered_number == number
        assert pool.replaced == 2


def test_workers_end_when_the_process_that_started_them_is_killed():
    """After SIGKILL of the parent, workers end within seconds because their sockets are closed."""
    code = (
        "import time; from training.workers.pool import Pool\n"
        "pool = Pool(2); [pool.submit(time.sleep, 0.1).result() for _ in range(4)]\n"
        "print(*[worker.process.pid for worker in pool.workers], flush=True); time.sleep(60)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    pids = list(map(int, process.stdout.readline().split()))
    # No code of the parent runs after this signal, so that it cannot end its workers.
    process.kill()
    process.wait()
    deadline = time.monotonic() + 50
    while time.monotonic() < deadline and any(map(is_alive, pids)):
        time.sleep(0.05)
    assert len(pids) == 2
    assert not any(map(is_alive, pids))


def test_training_with_processes_some_of_which_die(tmp_path, capsys):
    run_folder = tmp_path / "run"
    options = ["--total-timesteps=200", "--eval-worlds=none"]
    assert main([*SMALL, *options, "--out", str(run_folder)], Dying) == 0
    checkpoint = Learner.saved(run_folder)
    # Lost episodes are driven again: neither transitions nor updates are missing.
    assert checkpoint["transitions"] >= 200
    assert checkpoint["updates"] == checkpoint["transitions"] // 10
    assert "died: replaced by a new one" in capsys.readouterr().err
    assert main(["--resume", "--out", str(run_folder), "--total-timesteps", "250"], Dying) == 0
    assert Learner.saved(run_folder)["transitions"] >= 250


def test_an_unusable_ray_address_is_reported_soon_and_in_one_line():
    # Ray itself would wait for minutes.
    began = time.monotonic()
    for address in ("127.0.0.1:1", "nowhere", "ray://127.0.0.1:1"):
        with pytest.raises(ApplrError, match="no Ray answers at"):
            connect(address, 1)
    assert time.monotonic() - began < 15
    with pytest.raises(ApplrError, match="--ray-address is 127.0.0.1:1, but there are no workers"):
        Pool(0, "127.0.0.1:1")


# Code that starts Ray and prints the addresses at which its processes listen: the sockets that the
# processes of this session have open, looked up in the kernel's tables (state 0A is LISTEN).
LISTENS = """
import os
from training.workers.ray import connect

ray = connect("local", 1)
session = os.path.basename(ray._private.worker._global_node.get_session_dir_path())
mine = set()
for pid in filter(str.isdigit, os.listdir("/proc")):
    try:
        if int(pid) == os.getpid() or session in open("/proc/%s/cmdline" % pid).read():
            mine |= {os.readlink(entry.path)[8:-1] for entry in os.scandir("/proc/%s/fd" % pid)}
    except OSError:
        continue  # The process has ended.
rows = [line.split() for name in ("tcp", "tcp6") for line in list(open("/proc/net/" + name))[1:]]
print(*{row[1].split(":")[0] for row in rows if row[3] == "0A" and row[9] in mine})
ray.shutdown()
"""


@pytest.mark.fault("20b")
@pytest.mark.slow
def test_ray_on_this_machine_listens_on_loopback_only():
    pytest.importorskip("ray")
    finished = subprocess.run(
        [sys.executable, "-c", LISTENS],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    # /proc/net's notation of 127.0.0.1 in IPv4 and IPv6.
    addresses = finished.stdout.splitlines()[-1].split()
    assert addresses, finished.stderr
    assert set(addresses) <= {"0100007F", "0000000000000000FFFF00000100007F"}


@pytest.mark.slow
def test_a_run_on_two_nodes_survives_the_loss_of_one(tmp_path):
    """A training on two Ray nodes loses one of them while both drive, and completes."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    try:
        victim = cluster.add_node(**node)
        options = ["--total-timesteps=400", "--eval-worlds=none"]
        address = ["--ray-address", cluster.address]
        run = toy_run(parse([*SMALL, *options, *address, "--out", str(tmp_path / "run")]), Slow)
        lost_at = []  # number of steps when the node is lost

        def lose_a_node():
            """Remove the second node once both nodes drive: no processor is left."""
            while run.steps < 50 or ray.available_resources().get("CPU"):
                time.sleep(0.05)
            lost_at.append(run.steps)
            cluster.remove_node(victim)

        losing = threading.Thread(target=lose_a_node)
        losing.start()
        status = run.run()
        losing.join()
    finally:
        cluster.shutdown()
    assert status == 0
    # The node was lost long before the end, so that the rest was driven without it.
    assert lost_at[0] < 300
    assert run.learner.transitions >= 400
