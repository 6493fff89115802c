"""Figures of learning: gradient steps of TD3, ours and stable-baselines3's in one run, and the actor's inference.

By hand, also on a GPU: `python -m tests.benchmarks.learning [cuda]`.
"""

import sys
import time
from types import SimpleNamespace

import numpy as np

BATCH, OBSERVATIONS, ACTIONS, HIDDEN = 256, 729, 8, (512, 512, 512)


def _replay(transitions=6000):
    from training.replay.buffer import Replay
    from training.replay.trajectory import TransitionLayout

    replay = Replay(TransitionLayout(), int(1.2 * transitions))
    for trajectory in _trajectories(transitions // 13):
        replay.add(trajectory)
    return replay


def _trajectories(n, t=13):
    from training.replay.trajectory import Trajectory, TransitionLayout

    rng = np.random.default_rng(0)
    for i in range(n):
        yield Trajectory.of(
            TransitionLayout(),
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

    from training.learner.learner import draw_batch
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
    from applr_ros1.policy.actor import Policy

    rng, sizes = np.random.default_rng(0), [OBSERVATIONS, *HIDDEN, ACTIONS]
    weights = {}
    for i, (width, out) in enumerate(zip(sizes[:-1], sizes[1:])):
        weights["%d.weight" % i] = (rng.normal(size=(out, width)) / np.sqrt(width)).astype(np.float32)
        weights["%d.bias" % i] = np.zeros(out, np.float32)
    actor, observation = Policy.of(weights), rng.uniform(-1, 1, OBSERVATIONS).astype(np.float32)
    return 1e6 / _rate(lambda: actor.action(observation), rounds=5, seconds=0.2), "us"


if __name__ == "__main__":
    where = "cuda" if "cuda" in sys.argv else "cpu"
    for figure in (td3_updates, sb3_td3_updates):
        try:
            print("%s on %s: %.1f %s" % (figure.__name__, where, *figure(where)))
        except ImportError as error:
            print(figure.__name__, error)
    print("actor_inference: %.1f %s" % actor_inference())
