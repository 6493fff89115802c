"""Figures of learning: gradient steps of TD3, ours and stable-baselines3's in one run, and the actor's inference.

Also, run by hand: `python -m tests.benchmarks.learning intake [cuda]`, transitions/s that the learner takes in;
`python -m tests.benchmarks.learning actors 1 2 4`, transitions per second that so many actors make.
"""

import sys
import time
from types import SimpleNamespace

import numpy as np

BATCH, OBSERVATIONS, ACTIONS, HIDDEN = 256, 729, 8, (512, 512, 512)


def _replay(transitions=6000):
    from training.replay.buffer import Replay
    from training.replay.trajectory import Layout

    replay = Replay(Layout(), int(1.2 * transitions))
    for trajectory in _trajectories(transitions // 13):
        replay.add(trajectory)
    return replay


def _trajectories(n, t=13):
    from training.replay.trajectory import Layout, Trajectory

    rng = np.random.default_rng(0)
    for i in range(n):
        yield Trajectory.of(
            Layout(),
            rng.uniform(-1, 1, (t + 1, OBSERVATIONS)),
            rng.uniform(-1, 1, (t, ACTIONS)),
            rng.normal(size=t),
            i % 10 > 0,
            {"actor": "a", "episode": i, "version": 0},
        )


def _rate(step, rounds=5, seconds=0.6, finish=lambda: None):
    """Best of some rounds, in steps per second."""
    for _ in range(8):
        step()
    finish()
    best = 0.0
    for _ in range(rounds):
        begun, n = time.perf_counter(), 0
        while n < 4 or time.perf_counter() - begun < seconds:
            step()
            n += 1
        finish()
        best = max(best, n / (time.perf_counter() - begun))
    return best


def td3_updates(device="cpu"):
    """Ours: sampling from the replay (4-step returns) and a gradient step; every second one of the policy, too."""
    import torch

    from training.learner.batch import draw_batch
    from training.td3.td3 import TD3, TD3Options

    replay, td3, rng = (
        _replay(),
        TD3(OBSERVATIONS, ACTIONS, TD3Options(net_arch=list(HIDDEN)), device=device),
        np.random.default_rng(0),
    )
    finish = torch.cuda.synchronize if device == "cuda" else lambda: None
    return _rate(lambda: td3.update(draw_batch(replay, rng, BATCH, 4, 0.95, td3.device)), finish=finish), "updates/s"


def sb3_td3_updates(device="cpu"):
    """stable-baselines3's TD3.train at the same shapes, from batches already made (no sampling)."""
    import gymnasium
    import stable_baselines3
    import torch

    class Spaces(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1, 1, (OBSERVATIONS,), np.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (ACTIONS,), np.float32)

    model = stable_baselines3.TD3(
        "MlpPolicy", Spaces(), batch_size=BATCH, buffer_size=10, policy_kwargs={"net_arch": list(HIDDEN)}, device=device
    )
    model.set_logger(stable_baselines3.common.logger.Logger(None, []))
    x = [torch.rand(BATCH, n, device=device) * 2 - 1 for n in (OBSERVATIONS, ACTIONS, 1, OBSERVATIONS, 1, 1)]
    data = SimpleNamespace(
        observations=x[0],
        actions=x[1],
        rewards=x[2],
        next_observations=x[3],
        dones=torch.zeros_like(x[4]),
        discounts=x[5],
    )
    model.replay_buffer.sample = lambda *a, **k: data
    return _rate(lambda: model.train(2, BATCH)) * 2, "updates/s"


def actor_inference():
    """One observation through the actor, as the node does it: numpy, 729 -> 3 x 512 -> 8."""
    from applr_ros1.policy.actor import Actor

    rng, sizes = np.random.default_rng(0), [OBSERVATIONS, *HIDDEN, ACTIONS]
    weights = {}
    for i, (width, out) in enumerate(zip(sizes[:-1], sizes[1:])):
        weights["%d.weight" % i] = (rng.normal(size=(out, width)) / np.sqrt(width)).astype(np.float32)
        weights["%d.bias" % i] = np.zeros(out, np.float32)
    actor, observation = Actor(weights), rng.uniform(-1, 1, OBSERVATIONS).astype(np.float32)
    return 1e6 / _rate(lambda: actor.action(observation), rounds=5, seconds=0.2), "us"


def learner_intake(device="cpu", utd_ratio=0.1, seconds=8.0):
    """Transitions/s from packed bytes to the replay and the store, with the paper's share of gradient steps."""
    import tempfile

    from training.learner.learner import Learner, LearnerOptions
    from training.replay.trajectory import Layout

    blobs = [t.pack() for t in _trajectories(20000 if utd_ratio == 0 else 4000)]
    with tempfile.TemporaryDirectory() as folder:
        learner = Learner(
            Layout(),
            LearnerOptions(buffer_size=300_000, utd_ratio=utd_ratio, device=device),
            folder,
        )
        begun = time.perf_counter()
        for blob in blobs:
            learner.take(blob)
            learner.train()
            if time.perf_counter() - begun > seconds:
                break
        return learner.transitions / (time.perf_counter() - begun), "transitions/s"


def actor_rate(actors, seconds=20.0):
    """Transitions per second of so many processes with random parameters in the built-in train worlds."""

    from training.actors.pool import make_pool
    from training.actors.scheduler import TaskScheduler
    from training.actors.tasks import RunnerSpec, WorkerSettings
    from training.replay.trajectory import Trajectory

    scheduler = TaskScheduler(0, 250, lambda transitions: 0.5, random=10**9)
    scheduler.ready = True
    options = {"env": "training.env.env:ApplrEnv", "options": {"worlds": "generated:train"}}
    settings = WorkerSettings(collect=RunnerSpec("training.actors.collector:Collector", options))
    pool = make_pool(settings, scheduler.next_task, actors)
    try:
        came, begun = 0, None
        while begun is None or time.perf_counter() - begun < seconds:
            for answer in pool.poll(0.2):
                if begun is not None:
                    came += len(Trajectory.unpack(answer.data))
            if (
                begun is None
                and min(scheduler._next_episode.values(), default=0) > 1
                and len(scheduler._next_episode) == actors
            ):
                begun = time.perf_counter()  # every actor has driven an episode: all is compiled
        return came / (time.perf_counter() - begun), "transitions/s"
    finally:
        pool.close()


if __name__ == "__main__":
    if "actors" in sys.argv:
        for n in map(int, sys.argv[sys.argv.index("actors") + 1 :]):
            print("%d actors: %.1f %s" % (n, *actor_rate(n)))
        sys.exit()
    where = "cuda" if "cuda" in sys.argv else "cpu"
    if "intake" in sys.argv:
        for share in (0.0, 0.1, 1.0):
            print("intake with %.1f gradient steps per transition: %.0f %s" % (share, *learner_intake(where, share)))
    for figure in (td3_updates, sb3_td3_updates):
        try:
            print("%s on %s: %.1f %s" % (figure.__name__, where, *figure(where)))
        except ImportError as error:
            print(figure.__name__, error)
    print("actor_inference: %.1f %s" % actor_inference())
