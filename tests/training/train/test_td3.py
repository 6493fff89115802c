"""Tests of TD3: step-by-step comparison with stable-baselines3, and the effect of each option."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from applr_ros1.policy.encoding import Mirror
from tests.support.refusals import refused
from training.train.td3.td3 import TD3, Batch, TD3Options


@pytest.fixture(autouse=True)
def _one_thread():
    """Use one thread: on a busy machine, threads for small matrices mostly wait."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def tensor(values):
    """Return a tensor of numbers in single precision."""
    return torch.from_numpy(np.asarray(values, np.float32))


def _batch(rng, size, observed, actions):
    """Return random transitions with n observed numbers and m actions, a fifth of them final."""
    # The order of the draws decides their values. The discount is that of returns over four
    # decisions, 0 after a final one.
    is_final = rng.random(size) < 0.2
    return Batch(
        observation=tensor(rng.uniform(-1, 1, (size, observed))),
        action=tensor(rng.uniform(-1, 1, (size, actions))),
        reward=tensor(rng.uniform(-1, 1, size)),
        discount=tensor(np.where(is_final, 0.0, 0.95**4)),
        next_observation=tensor(rng.uniform(-1, 1, (size, observed))),
        noise=tensor(rng.standard_normal((size, actions))),
    )


def _converted(batch, convert):
    """Return a batch with all tensors converted by a function."""
    tensors = {}
    for field_name, values in vars(batch).items():
        tensors[field_name] = convert(values)
    return Batch(**tensors)


def first_weight(td3):
    """Return the weights of the actor's first layer, as actors get them."""
    return td3.actor_weights()["0.weight"]


def _sb3(observed, actions, hidden, batch_size):
    """Return stable-baselines3's learner for n observed numbers and m actions."""
    gym = pytest.importorskip("gymnasium")
    sb3 = pytest.importorskip("stable_baselines3")

    class Spaces(gym.Env):
        observation_space = gym.spaces.Box(-1, 1, (observed,), np.float32)
        action_space = gym.spaces.Box(-1, 1, (actions,), np.float32)

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
    """Return the actions (n, m) of the learnt policy, without noise and its mirror image."""
    with torch.no_grad():
        return torch.tanh(td3.policy(torch.as_tensor(observation))).numpy()


def _pairs(td3, model):
    """Return pairs (our parameters, stable-baselines3's parameters) of all networks."""
    critic = model.critic
    critic_target = model.critic_target
    networks = [
        (td3.actor, model.actor.mu),
        (td3.actor_target, model.actor_target.mu),
        *zip(td3.critics, (critic.qf0, critic.qf1)),
        *zip(td3.critic_targets, (critic_target.qf0, critic_target.qf1)),
    ]
    parameters = []
    for our_network, their_network in networks:
        parameters += zip(our_network.parameters(), their_network.parameters(), strict=True)
    return parameters


def _sb3_update(model, batch, seed):
    """Make one update of stable-baselines3 on our batch.

    It draws the smoothing noise from torch's generator.
    """
    sb3_batch = SimpleNamespace(
        observations=batch.observation,
        actions=batch.action,
        rewards=batch.reward[:, None],
        next_observations=batch.next_observation,
        dones=torch.zeros(len(batch.reward), 1),
        discounts=batch.discount[:, None],
    )
    # Our batch instead of a drawn one. Its discounts already tell which transitions are final.
    model.replay_buffer.sample = lambda *a, **k: sb3_batch
    torch.manual_seed(seed)
    model.train(1, len(batch.reward))


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("n", "m", "hidden", "size", "double"),
    [
        (30, 4, (96, 80), 64, False),
        pytest.param(729, 8, (512, 512, 512), 256, True, marks=pytest.mark.slow),
    ],
)
def test_equals_stable_baselines3_over_ten_updates(n, m, hidden, size, double, monkeypatch):
    """The paper's size needs double precision, because rounding dominates Adam's first steps."""
    # Stable-baselines3 has one learning rate for both.
    monkeypatch.setattr("training.train.td3.td3.ACTOR_LR", 1e-3)
    rng = np.random.default_rng(5)
    options = TD3Options(net_arch=hidden, critic_lr=1e-3)
    td3 = TD3(n, m, options, seed=3)
    model = _sb3(n, m, hidden, size)
    precision = torch.float64 if double else torch.float32
    td3.networks.to(precision)
    model.policy.to(precision)
    # stable-baselines3 would convert the observations to single precision.
    monkeypatch.setattr(
        "stable_baselines3.common.policies.preprocess_obs",
        lambda observation, *_, **__: observation,
    )

    # Given: the same networks in both
    with torch.no_grad():
        # Some actions are near 1 or -1, so that noise leaves [-1, 1].
        td3.actor_target[-1].bias += torch.linspace(-2.0, 2.0, m, dtype=precision)
        for our_parameter, their_parameter in _pairs(td3, model):
            their_parameter.copy_(our_parameter)
    initial_weights = td3.actor[0].weight.clone()

    # When: both are updated with the same batches and noise
    for seed in range(10):
        batch = _batch(rng, size, n, m)
        batch = _converted(batch, lambda values: values.to(precision))
        # stable-baselines3 draws noise of this deviation, and ours is scaled by it later.
        torch.manual_seed(seed)
        batch.noise = torch.empty(size, m, dtype=precision).normal_(0, 0.2) / 0.2
        td3.update(batch)
        _sb3_update(model, batch, seed)

    # Then: their networks are still the same
    for our_parameter, their_parameter in _pairs(td3, model):
        torch.testing.assert_close(
            our_parameter.data,
            their_parameter.data,
            atol=1e-5,
            rtol=0,
        )
    change = td3.actor[0].weight - initial_weights
    assert change.abs().max() > 1e-3, "the policy has not changed"


@pytest.mark.parametrize("alpha", [0.0, 2.5])
@pytest.mark.parametrize("penalty", [0.0, 0.3])
def test_the_policys_loss_has_the_terms_of_td3bc_and_of_the_preactivations(alpha, penalty):
    """The gradient is that of scaled -Q, behaviour cloning and the mean square before tanh."""
    options = TD3Options(net_arch=[16, 16], bc_alpha=alpha, preactivation_l2=penalty)
    td3 = TD3(12, 3, options, seed=1)
    batch = _batch(np.random.default_rng(0), 32, 12, 3)

    # TD3+BC's loss (Fujimoto and Gu, 2021), and a penalty on what tanh gets
    before_tanh = td3.actor(batch.observation)
    action = torch.tanh(before_tanh)
    first_critic, _ = td3.critics
    value = first_critic(torch.cat((batch.observation, action), 1))
    loss = -value.mean()
    if alpha:
        cloning_loss = ((action - batch.action) ** 2).mean()
        scale = alpha / value.abs().mean().item()
        loss = loss * scale + cloning_loss
    loss = loss + penalty * (before_tanh**2).mean()
    expected_gradients = torch.autograd.grad(loss, list(td3.actor.parameters()))

    td3.update_actor(batch)

    for parameter, gradient in zip(td3.actor.parameters(), expected_gradients, strict=True):
        torch.testing.assert_close(
            parameter.grad,
            gradient,
            atol=1e-7,
            rtol=1e-5,
        )
    for parameter in td3.critics.parameters():
        assert parameter.grad is None


def test_layer_norm_is_on_the_hidden_layers_of_the_critics():
    td3 = TD3(10, 3, TD3Options(net_arch=[32, 32], layer_norm=True))
    observation = torch.rand(7, 10)
    critics_input = torch.cat((observation, torch.rand(7, 3)), 1)
    _, critic = td3.critics
    first_layer, second_layer, last_layer = critic

    # Without gain and shift; 1e-5 is torch's default of epsilon.
    hidden = critics_input
    for layer in (first_layer, second_layer):
        hidden = layer(hidden)
        mean = hidden.mean(1, keepdim=True)
        variance = hidden.var(1, correction=0, keepdim=True)
        hidden = ((hidden - mean) / (variance + 1e-5).sqrt()).relu()
    torch.testing.assert_close(critic(critics_input), last_layer(hidden))

    # The actor has none.
    first_layer, second_layer, last_layer = td3.actor
    hidden = first_layer(observation).relu()
    hidden = second_layer(hidden).relu()
    torch.testing.assert_close(td3.actor(observation), last_layer(hidden))


def test_actors_get_the_running_average_and_the_state_contains_it():
    rng = np.random.default_rng(0)
    options = TD3Options(net_arch=[64], policy_ema_decay=0.75)
    plain = TD3(10, 2, TD3Options(net_arch=[64]), seed=7)
    averaged = TD3(10, 2, options, seed=7)

    expected_average = first_weight(averaged)
    for _ in range(6):
        batch = _batch(rng, 64, 10, 2)
        averaged.update(batch)
        plain.update(batch)
        if averaged.updates % 2 == 0:  # Every second update is one of the policy as well.
            expected_average = 0.75 * expected_average + 0.25 * first_weight(plain)

    learnt_weight = averaged.actor[0].weight
    assert torch.equal(learnt_weight, plain.actor[0].weight), "the average affects learning"
    np.testing.assert_allclose(first_weight(averaged), expected_average, atol=1e-6)

    resumed = TD3(10, 2, options, seed=8)
    resumed.load(averaged.state())
    np.testing.assert_array_equal(first_weight(resumed), first_weight(averaged))

    # The state of a run without an average
    refused(lambda: resumed.load(plain.state()), "the same --net-arch, .* and --policy-ema-decay")


def test_a_loaded_learner_takes_the_same_steps_and_keeps_its_own_learning_rates():
    rng = np.random.default_rng(0)
    options = TD3Options(net_arch=[16])
    uninterrupted = TD3(6, 2, options, seed=1)
    # The next update after three is one of the policy as well.
    for _ in range(3):
        uninterrupted.update(_batch(rng, 32, 6, 2))
    # A copy, as a checkpoint is: the optimisers would share their moments.
    state = copy.deepcopy(uninterrupted.state())

    loaded = TD3(6, 2, options, seed=2)
    loaded.load(copy.deepcopy(state))
    for _ in range(3):
        batch = _batch(rng, 32, 6, 2)
        uninterrupted.update(batch)
        loaded.update(batch)
    for parameter, expected in zip(
        loaded.networks.parameters(), uninterrupted.networks.parameters(), strict=True
    ):
        assert torch.equal(parameter, expected)

    slower = TD3(6, 2, TD3Options(net_arch=[16], critic_lr=1e-4), seed=2)
    slower.load(state)
    (group,) = slower.critic_optimizer.param_groups
    assert group["lr"] == 1e-4


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_gives_the_same_weights():
    rng = np.random.default_rng(0)
    options = TD3Options(net_arch=[64, 64])
    cpu = TD3(40, 3, options, device="cpu")
    gpu = TD3(40, 3, options, device="cuda")
    for _ in range(30):
        batch = _batch(rng, 64, 40, 3)
        cpu.update(batch)
        gpu.update(_converted(batch, torch.Tensor.cuda))
    for on_gpu, on_cpu in zip(gpu.networks.parameters(), cpu.networks.parameters()):
        torch.testing.assert_close(
            on_gpu.cpu(),
            on_cpu,
            atol=2e-4,
            rtol=0,
        )


def test_a_symmetric_policy_is_the_mean_of_the_learnt_one_and_its_mirror_image():
    from applr_ros1.policy.actor import Policy

    options = TD3Options(net_arch=[32, 16], symmetric=True)
    td3 = TD3(729, 8, options, seed=3, mirror=Mirror.of(720, 9))
    rng = np.random.default_rng(0)
    observations = rng.uniform(-1, 1, (20, 729)).astype(np.float32)
    ranges = observations[:, :720]
    goal_angle = observations[:, 720:721]
    parameters = observations[:, 721:]
    mirrored = np.concatenate((ranges[:, ::-1], -goal_angle, parameters), axis=1)
    # The mean is that of the outputs before tanh.
    output = np.arctanh(action_of(td3, observations).astype(float))
    output_of_mirrored = np.arctanh(action_of(td3, mirrored).astype(float))
    assert np.abs(output - output_of_mirrored).max() > 0.01

    actor = Policy.of(td3.actor_weights())

    actions = actor.action(observations)
    mean_output = (output + output_of_mirrored) / 2
    np.testing.assert_allclose(actions, np.tanh(mean_output), atol=1e-5)
    np.testing.assert_allclose(actor.action(mirrored), actions, atol=1e-6)
    np.testing.assert_allclose(actor.action(observations[0]), actions[0], atol=1e-6)


def test_a_policy_can_start_at_a_parameter_set_and_learns_from_there():
    rng = np.random.default_rng(0)
    observations = rng.uniform(-1, 1, (5, 10)).astype(np.float32)
    td3 = TD3(10, 3, TD3Options(net_arch=[64], policy_ema_decay=0.75), seed=7)
    td3.begin_at([0.5, -0.25, 1.0])
    first_actions = action_of(td3, observations)
    # tanh reaches 1 only without a gradient, so that 1 becomes 0.95.
    expected_actions = np.tile([0.5, -0.25, 0.95], (5, 1))
    np.testing.assert_allclose(first_actions, expected_actions, atol=0.01)
    for seed in range(10):
        td3.update(_batch(np.random.default_rng(seed), 64, 10, 3))
    assert (action_of(td3, observations) != first_actions).all()


@pytest.mark.parametrize("is_taken_over", [True, False], ids=["a policy", "a parameter set"])
def test_target_actions_begin_at_the_start_of_the_policy(is_taken_over):
    """Otherwise, the critics would first learn the values of a random policy."""
    observations = torch.rand(7, 5)
    options = TD3Options(net_arch=[8], policy_ema_decay=0.75)
    td3 = TD3(5, 2, options, seed=2)
    fresh_outputs = td3.actor_target(observations)
    if is_taken_over:
        td3.begin_with(TD3(5, 2, options, seed=1).actor_weights())
    else:
        td3.begin_at([0.5, -0.25])

    outputs = td3.actor(observations)
    assert (outputs - fresh_outputs).abs().max() > 0.1
    assert torch.equal(td3.actor_target(observations), outputs)
    assert torch.equal(td3.policy(observations), outputs)


def test_a_policy_that_is_taken_over_is_frozen_during_the_critic_warm_up(monkeypatch):
    monkeypatch.setattr("training.train.td3.td3.CRITIC_WARM_UP", 2)
    monkeypatch.setattr("training.train.td3.td3.POLICY_DELAY", 1)
    options = TD3Options(net_arch=[8])
    source = TD3(5, 2, options, seed=1)
    td3 = TD3(5, 2, options, seed=2)
    td3.begin_with(source.actor_weights())
    has_moved = []
    for _ in range(3):
        state = td3.state()
        td3 = TD3(5, 2, options, seed=3)
        td3.load(state)  # A run continues from its last checkpoint.
        td3.update(_batch(np.random.default_rng(0), 8, 5, 2))
        has_moved.append(not np.array_equal(first_weight(td3), first_weight(source)))
    assert has_moved == [False, False, True]


def test_only_critics_receive_the_hidden_numbers():
    """The policy has no weights for the hidden numbers, and the critics' values depend on them."""
    hidden_count = 3
    td3 = TD3(8, 2, TD3Options(net_arch=[16]), hidden=hidden_count)
    assert first_weight(td3).shape == (16, 8 - hidden_count)
    batch = _batch(np.random.default_rng(0), 32, 8, 2)
    for _ in range(2):
        td3.update(batch)
    other_observation = batch.observation.clone()
    other_observation[:, -hidden_count:] += 1.0

    critic, _ = td3.critics
    value = critic(torch.cat((batch.observation, batch.action), 1))
    value_of_other = critic(torch.cat((other_observation, batch.action), 1))

    assert (value - value_of_other).abs().min() > 1e-4


def test_smoothness_weights_the_change_of_each_parameter_between_two_observations(monkeypatch):
    monkeypatch.setattr("training.train.td3.td3.ACTOR_LR", 1e-3)
    batch = _batch(np.random.default_rng(0), 64, 6, 2)

    def change(weights):
        """Return the mean change (2,) of each parameter after 30 updates."""
        options = TD3Options(net_arch=[32], smoothness=weights)
        td3 = TD3(6, 2, options, seed=1)
        for _ in range(30):
            td3.update_actor(batch)
        actions = action_of(td3, batch.observation)
        next_actions = action_of(td3, batch.next_observation)
        return np.abs(next_actions - actions).mean(axis=0)

    free_change = change([0.0])
    assert (change([100.0]) < 0.5 * free_change).all()
    # Only the second parameter is weighted. The first one shares layers with it, and changes a
    # little.
    first_change, second_change = change([0.0, 100.0])
    assert first_change > 0.6 * free_change[0]
    assert second_change < 0.5 * free_change[1]


def test_smoothness_has_one_weight_or_one_for_each_parameter():
    options = TD3Options(smoothness=[1.0, 1.0, 1.0])
    refused(lambda: TD3(6, 2, options), "--smoothness has 3 numbers: give 1 or 2")
