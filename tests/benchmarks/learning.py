"""Figures of learning: gradient steps of TD3, ours and stable-baselines3's, and the actor's inference. For run.py."""

import time
from types import SimpleNamespace

import numpy as np

from tests.support.episodes import episode
from tests.support.weights import make_weights

BATCH, OBSERVATIONS, ACTIONS, HIDDEN = 256, 729, 8, (512, 512, 512)


def _replay(transitions=6000):
    from training.replay.buffer import Replay
    from training.replay.trajectory import TransitionLayout

    layout = TransitionLayout()
    replay = Replay(layout, int(1.2 * transitions))
    for number in range(transitions // 13):
        replay.add(episode(layout, number, 13, terminated=number % 10 > 0, version=0))
    return replay


def _rate(step, rounds=5, seconds=0.6):
    """Best of some rounds, in steps per second."""
    for _ in range(8):
        step()
    best = 0.0
    for _ in range(rounds):
        begun, n = time.perf_counter(), 0
        while n < 4 or time.perf_counter() - begun < seconds:
            step()
            n += 1
        best = max(best, n / (time.perf_counter() - begun))
    return best


def td3_updates():
    """Ours: sampling from the replay (4-step returns) and a gradient step; every second one of the policy, too."""
    from training.learner.learner import draw_batch
    from training.td3.td3 import TD3, TD3Options

    replay, rng = _replay(), np.random.default_rng(0)
    td3 = TD3(OBSERVATIONS, ACTIONS, TD3Options(net_arch=list(HIDDEN)))
    return _rate(lambda: td3.update(draw_batch(replay, rng, BATCH, 4, 0.95, td3.device))), "updates/s"


def sb3_td3_updates():
    """stable-baselines3's TD3.train at the same shapes, from batches already made (no sampling)."""
    import gymnasium
    import stable_baselines3
    import torch

    class Spaces(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1, 1, (OBSERVATIONS,), np.float32)
        action_space = gymnasium.spaces.Box(-1, 1, (ACTIONS,), np.float32)

    model = stable_baselines3.TD3(
        "MlpPolicy", Spaces(), batch_size=BATCH, buffer_size=10, policy_kwargs={"net_arch": list(HIDDEN)}
    )
    model.set_logger(stable_baselines3.common.logger.Logger(None, []))
    x = [torch.rand(BATCH, n) * 2 - 1 for n in (OBSERVATIONS, ACTIONS, 1, OBSERVATIONS, 1, 1)]
    names = "observations", "actions", "rewards", "next_observations", "dones", "discounts"
    data = SimpleNamespace(**dict(zip(names, x), dones=torch.zeros(BATCH, 1)))
    model.replay_buffer.sample = lambda *a, **k: data
    return _rate(lambda: model.train(2, BATCH)) * 2, "updates/s"


def actor_inference():
    """One observation through the actor, as the node does it: numpy, 729 -> 3 x 512 -> 8."""
    from applr_ros1.policy.actor import Policy

    actor = Policy.of(make_weights(hidden=HIDDEN, inputs=OBSERVATIONS, outputs=ACTIONS))
    observation = np.random.default_rng(0).uniform(-1, 1, OBSERVATIONS).astype(np.float32)
    return 1e6 / _rate(lambda: actor.action(observation), rounds=5, seconds=0.2), "us"
