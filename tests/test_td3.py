"""TD3 beside stable-baselines3's, step by step, and on a task small enough to learn in seconds."""

import numpy as np
import pytest
import torch

from training.experience.replay import Replay
from training.experience.trajectory import Layout, Trajectory
from training.gorila.batch import draw_batch
from training.td3.batch import Batch
from training.td3.networks import MLP
from training.td3.td3 import TD3, LearnerError, TD3Config


@pytest.fixture(autouse=True)
def _one_thread():
    """On a busy machine the threads of a small product wait for each other ten times as long as it takes."""
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


def _copy_to_sb3(td3, model):
    pairs = [
        (td3.actor, model.actor.mu),
        (td3.actor_target, model.actor_target.mu),
        *zip(td3.critics, (model.critic.qf0, model.critic.qf1)),
        *zip(td3.critic_targets, (model.critic_target.qf0, model.critic_target.qf1)),
    ]
    with torch.no_grad():
        for ours, theirs in pairs:
            for (weight, bias), layer in zip(ours.layers, [x for x in theirs if hasattr(x, "weight")]):
                layer.weight.copy_(weight)
                layer.bias.copy_(bias)
    return pairs


def _sb3_update(model, batch, seed):
    """One of SB3's updates on our batch; its smoothing noise is drawn from torch's generator."""
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
    ("n", "m", "hidden", "size", "double"), [(30, 4, (96, 80), 64, False), (729, 8, (512, 512, 512), 256, True)]
)
def test_equals_stable_baselines3_over_ten_updates(n, m, hidden, size, double, monkeypatch):
    """At the paper's size in double precision: there, in single, Adam's first steps of tiny gradients are rounding."""
    rng = np.random.default_rng(5)
    td3 = TD3(n, m, TD3Config(hidden=hidden, actor_lr=1e-3, critic_lr=1e-3), seed=3)
    model = _sb3(n, m, hidden, size)
    if double:
        model.policy.double()
        monkeypatch.setattr("stable_baselines3.common.policies.preprocess_obs", lambda obs, *a, **k: obs)  # no .float()
        for p in td3.tensors().values():
            p.data = p.data.double()
    pairs = _copy_to_sb3(td3, model)
    start = td3.actor.layers[0][0].clone()
    for i in range(10):
        batch = _batch(rng, size, n, m)
        torch.manual_seed(i)
        batch.noise = torch.empty(size, m).normal_(0, 0.2) / 0.2
        if double:
            batch = Batch(**{k: v.double() for k, v in vars(batch).items()})
            torch.manual_seed(i)
            batch.noise = torch.empty(size, m, dtype=torch.float64).normal_(0, 0.2) / 0.2
        td3.update(batch)
        _sb3_update(model, batch, i)
    for ours, theirs in pairs:
        for (weight, bias), layer in zip(ours.layers, [x for x in theirs if hasattr(x, "weight")]):
            torch.testing.assert_close(weight, layer.weight.data, atol=1e-5, rtol=0)
            torch.testing.assert_close(bias, layer.bias.data, atol=1e-5, rtol=0)
    assert (td3.actor.layers[0][0] - start).abs().max() > 1e-3  # it did move


@pytest.mark.parametrize(
    ("alpha", "saturation", "critics"), [(0.0, 0.0, 2), (2.5, 0.0, 2), (0.0, 0.3, 2), (2.5, 0.3, 2), (2.5, 0.3, 3)]
)
def test_gradients_equal_autograd(alpha, saturation, critics):
    """The written-out gradient of the policy's loss, TD3+BC's and the saturation's terms included."""
    td3 = TD3(12, 3, TD3Config(hidden=(16, 16), bc_alpha=alpha, saturation=saturation, critics=critics), seed=1)
    batch = _batch(np.random.default_rng(0), 32, 12, 3)
    parameters = [p.clone().requires_grad_() for p in td3.actor.parameters]

    def mlp(x, layers):
        for i in range(0, len(layers), 2):
            x = torch.nn.functional.linear(x, layers[i], layers[i + 1])
            x = x.relu() if i + 2 < len(layers) else x
        return x

    z = mlp(batch.observation, parameters)
    action = torch.tanh(z)
    climbed = td3.critics if critics > 2 else td3.critics[:1]
    q = sum(mlp(torch.cat((batch.observation, action), 1), critic.parameters) for critic in climbed) / len(climbed)
    loss = -q.mean()
    if alpha:
        loss = -alpha * q.mean() / q.abs().mean().detach() + torch.nn.functional.mse_loss(action, batch.action)
    loss = loss + saturation * z.square().mean()
    loss.backward()
    with torch.no_grad():
        td3._update_actor(batch)
    for p, q in zip(td3.actor.parameters, parameters):
        torch.testing.assert_close(p.grad, q.grad, atol=1e-7, rtol=1e-5)


def test_of_more_than_two_critics_each_transition_draws_two():
    td3 = TD3(12, 4, TD3Config(hidden=(16,), critics=4), seed=1)
    batch = _batch(np.random.default_rng(0), 200, 12, 4)
    there = torch.cat((batch.next_observation, batch.action), 1)
    target = td3._target(there, batch.noise)[:, 0]
    values = torch.cat([critic.forward(there) for critic in td3.critic_targets], 1).sort(1).values
    ranks = (values == target[:, None]).int().argmax(1)
    shares = torch.bincount(ranks, minlength=4) / 200.0  # of six pairs three hold the lowest, two the second, one...
    torch.testing.assert_close(shares, torch.tensor([1 / 2, 1 / 3, 1 / 6, 0.0]), atol=0.1, rtol=0)
    before = [critic.layers[0][0].clone() for critic in td3.critics]
    td3.update(batch)
    assert all((critic.layers[0][0] != old).any() for critic, old in zip(td3.critics, before))
    arrays, header = td3.state()
    TD3(12, 4, td3.config, seed=2).load(arrays, header)
    with pytest.raises(LearnerError, match="critics is 5: give 2, or up to as many as actions"):
        TD3(12, 4, TD3Config(critics=5))


@pytest.mark.parametrize(("bins", "bf16"), [(0, False), (51, False), (51, True)])
def test_learns_a_small_task(bins, bf16):
    """Go to zero on a line: x' = x + .3 a, r = -|x'|, ten steps cut by a time limit. Best return from x_0 = 1: -1.8."""
    layout, rng = Layout(scan=0, rest=1, action=1), np.random.default_rng(0)
    critics = {"bins": bins, "value_low": -5.0, "value_high": 1.0, "bf16": bf16}
    td3 = TD3(1, 1, TD3Config(hidden=(64, 64), actor_lr=1e-3, batch_size=128, gamma=0.9, n_step=2, **critics), seed=0)
    replay = Replay(layout, 5000)

    def episode(policy):
        x, states, actions, rewards = rng.uniform(-1, 1), [], [], []
        for _ in range(10):
            a = float(np.clip(policy(x), -1, 1))
            states.append(x)
            x += 0.3 * a
            actions.append(a)
            rewards.append(-abs(x))
        return states + [x], actions, rewards

    for i in range(60):
        states, actions, rewards = episode(lambda x: td3.action(np.array([[x]]))[0, 0] + 0.4 * rng.standard_normal())
        replay.add(Trajectory.of(layout, states, actions, rewards, False, {"actor": "a", "episode": i}))
        for _ in range(20):
            td3.update(draw_batch(replay, rng, 128, 2, 0.9))
    returns = [sum(episode(lambda x: td3.action(np.array([[x]]))[0, 0])[2]) for _ in range(40)]
    assert np.mean(returns) > -1.2  # doing nothing: -5; the best: -.83


def test_same_seed_same_weights_and_state_round_trip():
    rng = np.random.default_rng(0)
    batches = [_batch(rng, 64, 10, 2) for _ in range(6)]
    config = TD3Config(hidden=(64, 64))
    a, b, c = TD3(10, 2, config, seed=7), TD3(10, 2, config, seed=7), TD3(10, 2, config, seed=8)
    for batch in batches[:3]:
        a.update(batch)
    c.load(*a.state())
    for batch in batches[:3]:
        b.update(batch)
    for batch in batches[3:]:
        for t in (a, b, c):
            t.update(batch)
    for other in (b, c):
        for name, tensor in a.tensors().items():
            assert torch.equal(tensor, other.tensors()[name]), name
    assert c.updates == 6


def test_running_average_is_what_is_handed_out_and_travels_with_the_state():
    rng = np.random.default_rng(0)
    plain = TD3(10, 2, TD3Config(hidden=(64,)), seed=7)
    td3 = TD3(10, 2, TD3Config(hidden=(64,), average=0.75), seed=7)
    expected = td3.actor_weights()["0.weight"]
    for batch in [_batch(rng, 64, 10, 2) for _ in range(6)]:
        td3.update(batch)
        plain.update(batch)
        if td3.updates % 2 == 0:
            expected = 0.75 * expected + 0.25 * plain.actor_weights()["0.weight"]
    assert torch.equal(td3.actor.layers[0][0], plain.actor.layers[0][0])  # learning itself is the same
    np.testing.assert_allclose(td3.actor_weights()["0.weight"], expected, atol=1e-6)
    again, late = (TD3(10, 2, TD3Config(hidden=(64,), average=0.75), seed=8) for _ in range(2))
    again.load(*td3.state())
    np.testing.assert_array_equal(again.actor_weights()["0.weight"], td3.actor_weights()["0.weight"])
    late.load(*plain.state())  # a run that had none so far
    np.testing.assert_array_equal(late.actor_weights()["0.weight"], plain.actor_weights()["0.weight"])


def test_refuses_another_network_and_leaves_its_own():
    td3, other = TD3(10, 2, TD3Config(hidden=(32,))), TD3(10, 2, TD3Config(hidden=(64,)))
    before = td3.actor_weights()
    with pytest.raises(LearnerError, match="layers .*64.*--hidden"):
        td3.load(*other.state())
    arrays, header = td3.state()
    arrays["actor/0.bias"] = arrays["actor/0.bias"] * np.nan
    with pytest.raises(LearnerError, match="NaN"):
        td3.load(arrays, header)
    for name, value in td3.actor_weights().items():
        assert np.array_equal(value, before[name])
    with pytest.raises(LearnerError, match="device"):
        TD3(3, 1, device="gpu9")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_cuda_graphs_give_the_same_weights():
    rng = np.random.default_rng(0)
    cpu, gpu = TD3(40, 3, TD3Config(hidden=(64, 64))), TD3(40, 3, TD3Config(hidden=(64, 64)), device="cuda")
    for _ in range(30):
        batch = _batch(rng, 64, 40, 3)
        cpu.update(batch)
        gpu.update(Batch(**{k: v.cuda() for k, v in vars(batch).items()}))
    for name, tensor in cpu.tensors().items():
        if "adam" not in name:
            torch.testing.assert_close(gpu.tensors()[name].cpu(), tensor, atol=2e-4, rtol=0)


def test_layer_norm_gradients_are_those_of_autograd():
    network = MLP([10, 32, 32, 3], np.random.default_rng(0), normalised=True)
    x = torch.randn(70, 10, generator=torch.Generator().manual_seed(1), requires_grad=True)
    kept = []
    with torch.no_grad():
        y = network.forward(x, kept)
    for tensor in network.parameters:
        tensor.requires_grad_(True)
    h = x
    for i, (weight, bias) in enumerate(network.layers):
        h = torch.nn.functional.linear(h, weight, bias)
        h = torch.nn.functional.layer_norm(h, h.shape[1:]).relu() if i < 2 else h
    torch.testing.assert_close(y, h.detach())
    dy = torch.ones_like(y)
    expected = torch.autograd.grad(h, [*network.parameters, x], dy)
    with torch.no_grad():
        found = [*network.backward(kept, dy), network.input_gradient(kept, dy, slice(0, None))]
    for ours, theirs in zip(found, expected):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


def test_products_in_bfloat16_are_near_those_in_float32_and_the_last_layer_is_exact():
    rng = np.random.default_rng(0)
    exact = MLP([20, 64, 64, 3], rng, normalised=True)
    half = exact.copy()
    half.half = True
    x, dy = torch.randn(80, 20), torch.randn(80, 3)
    kept, kept_half = [], []
    y, y_half = exact.forward(x, kept), half.forward(x, kept_half)
    assert y_half.dtype == torch.float32
    assert 0.0 < float((y - y_half).abs().max()) < 0.05 * float(y.abs().max())
    gradients, gradients_half = exact.backward(kept, dy), half.backward(kept_half, dy)
    for gradient, other in zip(gradients, gradients_half):
        assert float((gradient - other).norm()) < 0.1 * float(gradient.norm())
    torch.testing.assert_close(gradients[-1], gradients_half[-1])  # of the last bias: dy's sum
    assert half.copy().half


def test_classifying_critics_have_the_gradients_of_autograd_and_keep_the_value():
    from training.td3.values import Classification

    head = Classification(-50.0, 10.0, 101, torch.device("cpu"))
    draw = torch.Generator().manual_seed(0)
    out = torch.randn(40, 101, generator=draw).requires_grad_()
    y = torch.rand(40, 1, generator=draw) * 50.0 - 45.0
    normal = torch.distributions.Normal(y, 0.75 * 60.0 / 101)
    target = normal.cdf(head.edges[:, 1:]) - normal.cdf(head.edges[:, :-1])
    target = target / target.sum(1, keepdim=True)
    torch.testing.assert_close(head.value(target.log()), y, atol=0.02, rtol=0)  # what is learnt is y
    loss = torch.nn.functional.cross_entropy(out, target)
    (expected,) = torch.autograd.grad(loss, out)
    found, gradient = head.error(out.detach(), y)
    torch.testing.assert_close(found, loss.detach())
    torch.testing.assert_close(gradient, expected, atol=1e-6, rtol=1e-3)
    dq = torch.randn(40, 1, generator=draw)
    (expected,) = torch.autograd.grad((head.value(out) * dq).sum(), out)
    torch.testing.assert_close(head.gradient(out.detach(), dq), expected, atol=1e-5, rtol=1e-3)
    ends = head.error(out.detach(), torch.tensor([[-80.0], [40.0]]).repeat(20, 1))[1]
    assert torch.isfinite(ends).all()
    with pytest.raises(LearnerError, match="1 bins from -50 to 10: give at least 2"):
        TD3(3, 1, TD3Config(bins=1))


def test_pooled_scan_becomes_an_actor_that_takes_every_beam():
    from applr_ros1.policy.actor import Actor

    td3 = TD3(729, 8, TD3Config(hidden=(32, 32), scan_pool=5, layer_norm=True), seed=3, scan=720)
    rng = np.random.default_rng(0)
    for _ in range(4):
        td3.update(_batch(rng, 64, 729, 8))
    observation = rng.uniform(-1, 1, (20, 729)).astype(np.float32)
    actor = Actor(td3.actor_weights())
    np.testing.assert_allclose(actor.action(observation), td3.action(observation), atol=1e-5)
    arrays, header = td3.state()
    other = TD3(729, 8, td3.config, seed=4, scan=720)
    other.load(arrays, header)
    np.testing.assert_array_equal(other.action(observation), td3.action(observation))
    with pytest.raises(LearnerError, match="divisor"):
        TD3(729, 8, TD3Config(scan_pool=7), scan=720)


@pytest.mark.parametrize("hidden", [(32, 16), ()])
def test_a_symmetric_policy_is_the_mean_of_the_learnt_one_and_its_mirror_image(hidden):
    from applr_ros1.policy.actor import Actor

    td3 = TD3(729, 8, TD3Config(hidden=hidden, scan_pool=5, symmetric=True), seed=3, scan=720)
    observation = np.random.default_rng(0).uniform(-1, 1, (20, 729)).astype(np.float32)
    mirrored = np.concatenate((observation[:, 719::-1], -observation[:, 720:721], observation[:, 721:]), axis=1)
    before = [np.arctanh(td3.action(seen).astype(float)) for seen in (observation, mirrored)]
    assert np.abs(before[0] - before[1]).max() > 0.01
    actor = Actor(td3.actor_weights())
    np.testing.assert_allclose(actor.action(observation), np.tanh((before[0] + before[1]) / 2), atol=1e-5)
    np.testing.assert_allclose(actor.action(mirrored), actor.action(observation), atol=1e-6)
    np.testing.assert_allclose(actor.action(observation[0]), actor.action(observation)[0], atol=1e-6)
    with pytest.raises(LearnerError, match="no scan and angle to mirror"):
        TD3(12, 3, TD3Config(symmetric=True))


def test_a_policy_can_begin_at_a_set_and_learns_from_there():
    observations = np.random.default_rng(0).uniform(-1, 1, (5, 10)).astype(np.float32)
    td3 = TD3(10, 3, TD3Config(hidden=(64,), average=0.75), seed=7)
    td3.begin_at([0.5, -0.25, 1.0])
    np.testing.assert_allclose(td3.action(observations), np.tile([0.5, -0.25, 0.95], (5, 1)), atol=0.01)
    first = td3.action(observations)
    for batch in [_batch(np.random.default_rng(i), 64, 10, 3) for i in range(10)]:
        td3.update(batch)
    assert (td3.action(observations) != first).all()
    with pytest.raises(LearnerError, match="begin at 2 numbers: give 3"):
        td3.begin_at([0.0, 0.0])
