"""TD3 (Fujimoto et al. 2018), the paper's algorithm: a policy and two critics of 3 x 512 units.

training/train/learner passes batches from the replay buffer. This module knows nothing of robots,
files or processes. Defaults are the paper's. If the paper gives no value, they are those of its
authors' code. Deviations:
  batch_size 256 (authors: 128): equally fast on our machines, with less gradient noise. Targets are
  of one step, as in the paper's equations (the authors' code began with 1 and ended at 4).
Unlike in the authors' code, values are bootstrapped at time limits, and target noise is in action
units (docs/explanation/learning_problem.md#where-this-differs-from-the-paper).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Dict, Optional, Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import nn
from torch.nn import functional
from typing_extensions import override

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.encoding import Mirror, with_mirror_images
from training.train.td3.options import TD3Options

ACTOR_LR = 3e-4  # learning rate of the policy
POLICY_DELAY = 2  # critic updates per policy update
# Share of the online networks that is mixed into the target networks at each policy update
TAU = 0.005
TARGET_NOISE = 0.2  # standard deviation of the noise on target actions
NOISE_CLIP = 0.5  # bound at which the noise on target actions is clipped
# Bound on the action that begin_at() makes a policy return, so that tanh still has a gradient
INNER = 0.95
SMALL_START = 0.01  # factor of begin_at() on the initial weights of the policy's last layer
# Updates during which a policy of begin_with() is frozen: untrained critics would spoil it
CRITIC_WARM_UP = 2000
# "0.weight" (out, in), "0.bias" (out,), "1.weight", ...: float32
ActorWeights = Dict[str, np.ndarray]


class MLP(nn.ModuleList):
    """Linear layers with ReLU between them.

    state_dict() names them "0.weight" (out, in), "0.bias" (out,), "1.weight".

    Args:
        inputs: Width of the input.
        hidden: Widths of the hidden layers.
        outputs: Width of the output.
        layer_norm: Whether to normalise each hidden layer before its ReLU, without gain and shift.
            In critics, this bounds the extrapolation to actions that were never tried, so that
            learning remains stable with several gradient steps per transition (Ball et al. 2023;
            Nauman et al. 2024).
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, layer_norm: bool = False):
        widths = [inputs, *hidden, outputs]
        layers = [nn.Linear(width, following) for width, following in zip(widths, widths[1:])]
        super().__init__(layers)
        self.layer_norm = layer_norm

    @override
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map x (B, inputs) to (B, outputs)."""
        *hidden_layers, last_layer = self
        for layer in hidden_layers:
            x = layer(x)
            if self.layer_norm:
                x = functional.layer_norm(x, x.shape[1:])
            x = functional.relu(x)
        output: torch.Tensor = last_layer(x)
        return output


@dataclass
class Batch:
    """Transitions of one update, as tensors on the learner's device.

    Attributes:
        observation: (B, n).
        action: (B, m) in [-1, 1].
        reward: (B,) sum of k discounted rewards.
        discount: (B,) gamma^k, or 0 if a terminal state was reached.
        next_observation: (B, n) k steps later.
        noise: (B, m) standard normal noise for target policy smoothing.
    """

    observation: torch.Tensor
    action: torch.Tensor
    reward: torch.Tensor
    discount: torch.Tensor
    next_observation: torch.Tensor
    noise: torch.Tensor


class TD3:
    """Networks, target networks and optimisers of TD3.

    Args:
        observations: Size of an observation.
        actions: Size of an action.
        options: Hyperparameters.
        seed: Seed of the initial weights.
        device: Torch device, such as "cuda:0".
        mirror: Left-right reflection of the policy's observation; None if unknown.
        hidden: Number of entries at the end of an observation that only the critics receive.

    Raises:
        ApplrError: The number of smoothness weights is neither 1 nor the size of an action.
    """

    def __init__(
        self,
        observations: int,
        actions: int,
        options: TD3Options = TD3Options(),  # noqa: B008
        seed: int = 0,
        device: str = "cpu",
        mirror: Optional[Mirror] = None,
        hidden: int = 0,
    ):
        self.options = options
        self.actions = actions
        self.mirror = mirror
        self.device = torch.device(device)
        if len(options.smoothness) not in (1, actions):
            raise ApplrError(
                f"--smoothness has {len(options.smoothness)} numbers: give 1 or {actions}"
            )
        self.smoothness = torch.tensor(options.smoothness, device=self.device)
        self.seen = observations - hidden  # number of entries that the policy receives

        # The seed gives the weights, whatever other code has drawn from torch's generator, and this
        # generator stays as it was.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            widths = options.net_arch
            self.actor = MLP(self.seen, widths, actions).to(self.device)
            first = MLP(observations + actions, widths, 1, options.layer_norm)
            second = MLP(observations + actions, widths, 1, options.layer_norm)
            self.critics = nn.ModuleList([first, second]).to(self.device)
        self.actor_target = copy.deepcopy(self.actor).requires_grad_(False)
        self.critic_targets = copy.deepcopy(self.critics).requires_grad_(False)
        # The names are those of the checkpoint's tensors.
        self.networks = nn.ModuleDict(
            {
                "actor": self.actor,
                "critics": self.critics,
                "actor_target": self.actor_target,
                "critic_targets": self.critic_targets,
            }
        )
        # Network that the actor processes get: self.actor, or its running average if enabled
        self.policy = self.actor
        if options.policy_ema_decay:
            self.policy = copy.deepcopy(self.actor).requires_grad_(False)
            self.networks["actor_average"] = self.policy

        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), ACTOR_LR, fused=True)
        self.critic_optimizer = torch.optim.Adam(
            self.critics.parameters(), options.critic_lr, fused=True
        )
        self.optimizers = {
            "actor_optimizer": self.actor_optimizer,
            "critic_optimizer": self.critic_optimizer,
        }
        self.updates = 0  # number of updates so far
        self.policy_starts = 0  # number of updates before the first one of the policy
        self.losses: Dict[str, torch.Tensor] = {}

    @torch.no_grad()
    def begin_at(self, action: ArrayLike) -> None:
        """Make a fresh policy return nearly `action` (m,) in [-1, 1] for every observation."""
        start = torch.as_tensor(action, dtype=torch.float32, device=self.device)
        bias = torch.atanh(start.clamp(-INNER, INNER))
        # A set, because without a running average the policy is the actor.
        for network in {self.actor, self.actor_target, self.policy}:
            last_layer: Any = network[-1]
            last_layer.weight.mul_(SMALL_START)
            last_layer.bias.copy_(bias)

    def begin_with(self, weights: ActorWeights) -> None:
        """Take over a policy's weights, and freeze the policy for the critic warm-up.

        Args:
            weights: Weights of the policy, named as by actor_weights().

        Raises:
            ApplrError: The layers differ.
        """
        tensors = {name: torch.from_numpy(array) for name, array in weights.items()}
        for network in {self.actor, self.actor_target, self.policy}:
            _fill(network, tensors)
        self.policy_starts = CRITIC_WARM_UP

    # -- learning ----------------------------------------------------------------------------------
    def update(self, batch: Batch) -> None:
        """Update the critics, and in every POLICY_DELAY-th call the policy and the targets."""
        self.updates += 1
        self._update_critics(batch)
        if self.updates % POLICY_DELAY == 0:
            if self.updates > self.policy_starts:
                self.update_actor(batch)
            self._update_targets()

    def _update_critics(self, batch: Batch) -> None:
        """Take a gradient step of both critics towards the clipped double-Q targets."""
        with torch.no_grad():
            # Target policy smoothing: clipped noise in action units, and an action clipped to its
            # range.
            noise = (batch.noise * TARGET_NOISE).clamp_(-NOISE_CLIP, NOISE_CLIP)
            next_action = torch.tanh(self.actor_target(batch.next_observation[:, : self.seen]))
            next_action.add_(noise).clamp_(-1.0, 1.0)
            # y = r + gamma^k min Q'(s', a') (clipped double Q), bootstrapping through time limits.
            following = torch.cat((batch.next_observation, next_action), 1)
            first_target, second_target = self.critic_targets
            value = torch.minimum(first_target(following), second_target(following))
            y = batch.reward[:, None] + batch.discount[:, None] * value
        driven = torch.cat((batch.observation, batch.action), 1)
        first, second = self.critics
        loss = functional.mse_loss(first(driven), y) + functional.mse_loss(second(driven), y)
        self.critic_optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.critic_optimizer.step()
        self.losses["critic_loss"] = loss.detach()
        self.losses["target_q"] = y.mean()

    def update_actor(self, batch: Batch) -> None:
        """Take one step along the gradient of the policy's loss, see `losses`."""
        options = self.options
        preactivation = self.actor(batch.observation[:, : self.seen])
        action = torch.tanh(preactivation)
        # Deterministic policy gradient (the paper's eq. 2): climb the first critic's Q.
        q = self.critics[0](torch.cat((batch.observation, action), 1))
        loss = -q.mean()
        if options.bc_alpha > 0.0:
            # TD3+BC (its eq. 5): alpha over the mean |Q| makes both terms independent of the
            # reward's scale.
            scale = options.bc_alpha / q.abs().mean().detach().clamp_(min=1e-6)
            loss = scale * loss + functional.mse_loss(action, batch.action)
        if any(options.smoothness):
            next_action = torch.tanh(self.actor(batch.next_observation[:, : self.seen]))
            change = action - next_action
            loss = loss + (self.smoothness * change.square()).mean()
        if options.preactivation_l2 > 0.0:
            loss = loss + options.preactivation_l2 * preactivation.square().mean()
        self.actor_optimizer.zero_grad()
        loss.backward(inputs=list(self.actor.parameters()))  # skips the critic's gradients
        self.actor_optimizer.step()
        self.losses["actor_q"] = q.detach().mean()

    @torch.no_grad()
    def _update_targets(self) -> None:
        _mix(self.actor_target, self.actor, TAU)
        _mix(self.critic_targets, self.critics, TAU)
        if self.policy is not self.actor:
            _mix(self.policy, self.actor, 1.0 - self.options.policy_ema_decay)

    def report(self) -> Dict[str, float]:
        """Return the losses of the latest update as numbers.

        Waits for the device.
        """
        return {name: float(value) for name, value in self.losses.items()}

    # -- acting ------------------------------------------------------------------------------------
    def actor_weights(self) -> ActorWeights:
        """Return a copy of the policy's weights, named as in policy/actor.py.

        The names are "0.weight" (512, 729), "0.bias", ... With options.symmetric, the policy and
        its mirror image (with_mirror_images) are stacked along each first axis.
        """
        weights = {}
        for name, tensor in self.policy.state_dict().items():
            weights[name] = tensor.cpu().numpy().copy()
        if self.options.symmetric and self.mirror:
            return with_mirror_images(weights, self.mirror)
        return weights

    # -- checkpoints -------------------------------------------------------------------------------
    def state(self) -> Dict[str, Any]:
        """Return the state for a checkpoint; load() is the inverse."""
        # Without param_groups, because load() keeps the learning rates of its own run.
        optimizers = {}
        for name, optimizer in self.optimizers.items():
            optimizers[name] = optimizer.state_dict()["state"]
        return {
            "networks": self.networks.state_dict(),
            "optimizers": optimizers,
            "updates": self.updates,
            "policy_starts": self.policy_starts,
        }

    def load(self, state: Dict[str, Any]) -> None:
        """Restore the state of a checkpoint, but keep this run's learning rates.

        Raises:
            ApplrError: The layers differ, or only one run has a running average.
        """
        _fill(self.networks, state["networks"])
        for name, optimizer in self.optimizers.items():
            restored = {**optimizer.state_dict(), "state": state["optimizers"][name]}
            optimizer.load_state_dict(restored)
        self.updates = state["updates"]
        self.policy_starts = state["policy_starts"]


def _fill(network: nn.Module, tensors: Dict[str, torch.Tensor]) -> None:
    """Load tensors into a network. Raise ApplrError if the layers differ."""
    try:
        network.load_state_dict(tensors)
    except RuntimeError:
        options = "--net-arch, --observation, --critics-know-more and --policy-ema-decay"
        raise ApplrError(f"its networks differ: give the same {options}") from None


def _mix(target: nn.Module, source: nn.Module, share: float) -> None:
    """Move each parameter of `target` towards that of `source` by a share of their difference."""
    torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), share)
