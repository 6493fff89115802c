"""Workers on a machine that is slow: one that is long in starting is waited for, whatever it is sent."""

import safetensors.numpy

from tests.training.actors.test_workers import TOY, collect, scheduler, trajectories
from training.actors import local
from training.actors.pool import make_pool
from training.td3.td3 import TD3, TD3Options

SLOW_START = "import sys, time\nif 'training.actors.worker' in sys.orig_argv:\n    time.sleep(2.5)\n"


def test_a_worker_that_starts_slowly_gets_a_policy_larger_than_the_socket_holds(tmp_path, monkeypatch):
    """Its first message waits unread for longer than a message may stop in the middle."""
    (tmp_path / "sitecustomize.py").write_text(SLOW_START)
    monkeypatch.syspath_prepend(tmp_path)  # a worker's path begins with this one's
    monkeypatch.setattr(local, "HALF_A_MESSAGE", 1)
    large = safetensors.numpy.save(TD3(1, 1, TD3Options(net_arch=[512, 512]), seed=0).actor_weights())
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
