"""Tests of TD3: step-by-step comparison with stable-baselines3, and the effect of each option."""

import numpy as np
import pytest
import torch

from applr_ros1.policy.encoding import Mirror
from tests.support.refusals import refused
from training.train.td3.td3 import TD3, Batch, TD3Options


@pytest.fixture(autouse=True)
def _one_thread():
    """Use one thread: on a busy machine, threads for small matrices wait ten times as long as they
    compute.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def _batch(rng, size, n, m, gamma=0.95):
    def floats(*shape):
        return torch.from_numpy(rng.uniform(-1, 1, shape).astype(np.float32))

    discount = torch.from_numpy(np.where(rng.random(size) < 0.2, 0.0, gamma**4).astype(np.float32))
    return Batch(
        floats(size, n),
        floats(size, m),
        floats(size),
        discount,
        floats(size, n),
        torch.from_numpy(rng.standard_normal((size, m)).astype(np.float32)),
    )


def _sb3(n, m, hidden, batch_size):
    gym = pytest.importorskip("gymnasium")
    sb3 = pytest.importorskip("stable_baselines3")

    class Spaces(gym.Env):
        observation_space = gym.spaces.Box(-1, 1, (n,), np.float32)
        action_space = gym.spaces.Box(-1, 1, (m,), np.float32)

    model = sb3.TD3(
        "MlpPolicy",
        Spaces(),
        learning_rate=1e-3,
        batch_size=batch_size,
        tau=0.005,
        buffer_size=10,
        policy_kwargs={"net_arch": list(hidden)},
        device="cpu",
    )
    model.set_logger(sb3.common.logger.Logger(None, []))
    return model


def action_of(td3, observation):
    """Return the actions (n, m) of the learnt policy, without noise and without its mirror
    image.
    """
    with torch.no_grad():
        return torch.tanh(td3.policy(torch.as_tensor(observation))).numpy()


def _pairs(td3, model):
    """Return pairs (our network, stable-baselines3's network)."""
    return [
        (td3.actor, model.actor.mu),
        (td3.actor_target, model.actor_target.mu),
        *zip(td3.critics, (model.critic.qf0, model.critic.qf1)),
        *zip(td3.critic_targets, (model.critic_target.qf0, model.critic_target.qf1)),
    ]


def _sb3_update(model, batch, seed):
    """Make one update of stable-baselines3 on our batch. It draws the smoothing noise from torch's
    generator.
    """
    from types import SimpleNamespace

    data = SimpleNamespace(
        observations=batch.observation,
        actions=batch.action,
        rewards=batch.reward[:, None],
        next_observations=batch.next_observation,
        dones=torch.zeros(len(batch.reward), 1),
        discounts=batch.discount[:, None],
    )
    model.replay_buffer.sample = lambda *a, **k: data
    torch.manual_seed(seed)
    model.train(1, len(batch.reward))


@pytest.mark.parametrize(
    ("n", "m", "hidden", "size", "double"),
    [(30, 4, (96, 80), 64, False), (729, 8, (512, 512, 512), 256, True)],
)
def test_equals_stable_baselines3_over_ten_updates(n, m, hidden, size, double, monkeypatch):
    """The paper's size needs double precision: in single precision, rounding dominates Adam's first
    steps.
    """
    # Stable-baselines3 has one learning rate for both.
    monkeypatch.setattr("training.train.td3.td3.ACTOR_LR", 1e-3)
    rng = np.random.default_rng(5)
    td3 = TD3(n, m, TD3Options(net_arch=hidden, critic_lr=1e-3), seed=3)
    model = _sb3(n, m, hidden, size)
    precision = torch.float64 if double else torch.float32
    td3.networks.to(precision)
    model.policy.to(precision)
    # No .float()
    monkeypatch.setattr(
        "stable_baselines3.common.policies.preprocess_obs", lambda obs, *a, **k: obs
    )
    with torch.no_grad():
        # So that noise leaves [-1, 1]
        td3.actor_target[-1].bias += torch.linspace(-2.0, 2.0, m, dtype=precision)
        for ours, theirs in _pairs(td3, model):
            for mine, other in zip(ours.parameters(), theirs.parameters()):
                other.copy_(mine)
    start = td3.actor[0].weight.clone()
    for index in range(10):
        batch = Batch(**{k: v.to(precision) for k, v in vars(_batch(rng, size, n, m)).items()})
        torch.manual_seed(index)
        batch.noise = torch.empty(size, m, dtype=precision).normal_(0, 0.2) / 0.2
        td3.update(batch)
        _sb3_update(model, batch, index)
    for ours, theirs in _pairs(td3, model):
        for mine, other in zip(ours.parameters(), theirs.parameters()):
            torch.testing.assert_close(mine.data, other.data, atol=1e-5, rtol=0)
    assert (td3.actor[0].weight - start).abs().max() > 1e-3  # The policy has changed.


def test_the_policys_loss_has_the_terms_of_td3bc_and_of_the_preactivations():
    """The gradient is that of scaled -Q, behaviour cloning and the mean square before tanh. No
    critic changes.
    """
    for alpha, penalty in ((0.0, 0.0), (2.5, 0.0), (0.0, 0.3), (2.5, 0.3)):
        td3 = TD3(
            12, 3, TD3Options(net_arch=[16, 16], bc_alpha=alpha, preactivation_l2=penalty), seed=1
        )
        batch = _batch(np.random.default_rng(0), 32, 12, 3)
        z = td3.actor(batch.observation)
        action = torch.tanh(z)
        q = td3.critics[0](torch.cat((batch.observation, action), 1))
        loss = (
            -q.mean() * (alpha / q.abs().mean().item() if alpha else 1.0) + penalty * (z**2).mean()
        )
        if alpha:
            loss = loss + ((action - batch.action) ** 2).mean()
        expected = torch.autograd.grad(loss, list(td3.actor.parameters()))
        td3.update_actor(batch)
        for parameter, gradient in zip(td3.actor.parameters(), expected):
            torch.testing.assert_close(parameter.grad, gradient, atol=1e-7, rtol=1e-5)
        assert all(parameter.grad is None for parameter in td3.critics.parameters())


def test_layer_norm_is_on_the_hidden_layers_of_the_critics():
    td3 = TD3(10, 3, TD3Options(net_arch=[32, 32], layer_norm=True))
    observation = torch.rand(7, 10)
    action = torch.rand(7, 3)
    x = torch.cat((observation, action), 1)
    first, second, last = td3.critics[1]
    for layer in (first, second):
        x = layer(x)
        x = (
            (x - x.mean(1, keepdim=True)) / (x.var(1, correction=0, keepdim=True) + 1e-5).sqrt()
        ).relu()
    torch.testing.assert_close(td3.critics[1](torch.cat((observation, action), 1)), last(x))
    first, second, last = td3.actor
    torch.testing.assert_close(
        td3.actor(observation), last(second(first(observation).relu()).relu())
    )


def test_actors_get_the_running_average_and_the_state_contains_it():
    rng = np.random.default_rng(0)
    plain = TD3(10, 2, TD3Options(net_arch=[64]), seed=7)
    td3 = TD3(10, 2, TD3Options(net_arch=[64], policy_ema_decay=0.75), seed=7)
    expected = td3.actor_weights()["0.weight"]
    for batch in [_batch(rng, 64, 10, 2) for _ in range(6)]:
        td3.update(batch)
        plain.update(batch)
        if td3.updates % 2 == 0:
            expected = 0.75 * expected + 0.25 * plain.actor_weights()["0.weight"]
    # The average does not affect learning.
    assert torch.equal(td3.actor[0].weight, plain.actor[0].weight)
    np.testing.assert_allclose(td3.actor_weights()["0.weight"], expected, atol=1e-6)
    again, late = (
        TD3(10, 2, TD3Options(net_arch=[64], policy_ema_decay=0.75), seed=8) for _ in range(2)
    )
    again.load(td3.state())
    np.testing.assert_array_equal(
        again.actor_weights()["0.weight"], td3.actor_weights()["0.weight"]
    )
    late.load(plain.state())  # state of a run without an average
    np.testing.assert_array_equal(
        late.actor_weights()["0.weight"], plain.actor_weights()["0.weight"]
    )


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_gives_the_same_weights():
    rng = np.random.default_rng(0)
    cpu, gpu = (
        TD3(40, 3, TD3Options(net_arch=[64, 64]), device=device) for device in ("cpu", "cuda")
    )
    for _ in range(30):
        batch = _batch(rng, 64, 40, 3)
        cpu.update(batch)
        gpu.update(Batch(**{k: v.cuda() for k, v in vars(batch).items()}))
    for ours, theirs in zip(gpu.networks.parameters(), cpu.networks.parameters()):
        torch.testing.assert_close(ours.cpu(), theirs, atol=2e-4, rtol=0)


def test_a_symmetric_policy_is_the_mean_of_the_learnt_one_and_its_mirror_image():
    from applr_ros1.policy.actor import Policy

    td3 = TD3(
        729, 8, TD3Options(net_arch=[32, 16], symmetric=True), seed=3, mirror=Mirror.of(720, 9)
    )
    observation = np.random.default_rng(0).uniform(-1, 1, (20, 729)).astype(np.float32)
    mirrored = np.concatenate(
        (observation[:, 719::-1], -observation[:, 720:721], observation[:, 721:]), axis=1
    )
    before = [np.arctanh(action_of(td3, seen).astype(float)) for seen in (observation, mirrored)]
    assert np.abs(before[0] - before[1]).max() > 0.01
    actor = Policy.of(td3.actor_weights())
    np.testing.assert_allclose(
        actor.action(observation), np.tanh((before[0] + before[1]) / 2), atol=1e-5
    )
    np.testing.assert_allclose(actor.action(mirrored), actor.action(observation), atol=1e-6)
    np.testing.assert_allclose(
        actor.action(observation[0]), actor.action(observation)[0], atol=1e-6
    )


def test_a_policy_can_start_at_a_parameter_set_and_learns_from_there():
    observations = np.random.default_rng(0).uniform(-1, 1, (5, 10)).astype(np.float32)
    td3 = TD3(10, 3, TD3Options(net_arch=[64], policy_ema_decay=0.75), seed=7)
    td3.begin_at([0.5, -0.25, 1.0])
    np.testing.assert_allclose(
        action_of(td3, observations), np.tile([0.5, -0.25, 0.95], (5, 1)), atol=0.01
    )
    first = action_of(td3, observations)
    for batch in [_batch(np.random.default_rng(index), 64, 10, 3) for index in range(10)]:
        td3.update(batch)
    assert (action_of(td3, observations) != first).all()


def test_a_policy_that_is_taken_over_is_frozen_during_the_critic_warm_up(monkeypatch):
    monkeypatch.setattr("training.train.td3.td3.CRITIC_WARM_UP", 2)
    monkeypatch.setattr("training.train.td3.td3.POLICY_DELAY", 1)
    options = TD3Options(net_arch=[8])
    begun = TD3(5, 2, options, seed=1)
    td3 = TD3(5, 2, options, seed=2)
    td3.begin_with(begun.actor_weights(), "it")
    moved = []
    for _ in range(3):
        state = td3.state()
        td3 = TD3(5, 2, options, seed=3)
        td3.load(state)  # A run continues from its last checkpoint.
        td3.update(_batch(np.random.default_rng(0), 8, 5, 2))
        moved.append(
            not np.array_equal(td3.actor_weights()["0.weight"], begun.actor_weights()["0.weight"])
        )
    assert moved == [False, False, True]


def test_only_critics_receive_the_hidden_numbers():
    """The policy's weights have no column for the hidden entries. The critics' values depend on
    these entries.
    """
    rng = np.random.default_rng(0)
    hidden = 3
    td3 = TD3(8, 2, TD3Options(net_arch=[16]), hidden=hidden)
    assert td3.actor_weights()["0.weight"].shape == (16, 8 - hidden)
    batch = _batch(rng, 32, 8, 2)
    for _ in range(2):
        td3.update(batch)
    other = batch.observation.clone()
    other[:, -hidden:] += 1.0
    values = [td3.critics[0](torch.cat((o, batch.action), 1)) for o in (batch.observation, other)]
    assert (values[0] - values[1]).abs().min() > 1e-4


def test_smoothness_weights_the_change_of_each_parameter_between_two_observations(monkeypatch):
    monkeypatch.setattr("training.train.td3.td3.ACTOR_LR", 1e-3)
    rng = np.random.default_rng(0)
    batch = _batch(rng, 64, 6, 2)
    way = []
    for weights in ([0.0], [100.0], [0.0, 100.0]):
        td3 = TD3(6, 2, TD3Options(net_arch=[32], smoothness=weights), seed=1)
        for _ in range(30):
            td3.update_actor(batch)
        here, there = (action_of(td3, o) for o in (batch.observation, batch.next_observation))
        way.append(np.abs(here - there).mean(axis=0))
    assert (way[1] < 0.5 * way[0]).all()
    assert way[2][1] < 0.5 * way[0][1]
    assert way[2][0] > 0.6 * way[0][0]
    refused(
        lambda: TD3(6, 2, TD3Options(smoothness=[1.0, 1.0, 1.0])),
        "--smoothness has 3 numbers: give 1 or 2",
    )
