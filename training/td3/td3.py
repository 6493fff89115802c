"""TD3 (Fujimoto et al. 2018), the paper's learner: a policy and two separate critics, each of 3 x 512 units.

learner.py feeds it batches from the replay; nothing here knows of robots, files or processes.
Defaults are the paper's; where it is silent, the authors' code's. Deviations, named:
  batch_size 256 (authors' 128): as fast on our machines, less noise.
  n_step 4 (the paper says nothing; the authors' code began with 1 and ended at 4): returns are summed by the replay.
Time limits are bootstrapped, target noise is in action units; the authors' code did neither
(docs/training.md#where-this-differs-from-the-paper).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
import torch

from applr_ros1.common.errors import ApplrError
from training.td3.averaging import Weights, mirrored, side_by_side
from training.td3.batch import Batch
from training.td3.graphs import Graphs
from training.td3.networks import MLP, Kept
from training.td3.values import Classification, Regression

INNER = 0.95  # a policy that begins at a set begins at most so far out, where tanh still has a gradient
SMALL_START = 0.01  # factor on the last layer's first weights of such a policy


class LearnerError(ApplrError):
    """Weights, sizes or a device that cannot be used; one line with what, why and the remedy."""


@dataclass(frozen=True)
class TD3Config:
    """The options of TD3 (Fujimoto et al. 2018) and of its variants here.

    Raises:
        LearnerError: for a range of values that cannot be divided into `bins`.
    """

    hidden: Tuple[int, ...] = (512, 512, 512)
    actor_lr: float = 3e-4
    critic_lr: float = 1e-3
    gamma: float = 0.95
    n_step: int = 4
    batch_size: int = 256
    tau: float = 0.005
    target_noise: float = 0.2  # standard deviation of the smoothing noise on target actions, of [-1, 1]
    noise_clip: float = 0.5
    policy_delay: int = 2
    critics: int = 2  # more than two: an ensemble (_target, _climbed)
    average: float = 0.0  # decay, per policy step, of the running average that is handed out; 0: none
    symmetric: bool = False  # hand out the mean of the policy and of its mirror image
    saturation: float = 0.0  # cost of the mean square of the policy's outputs before tanh: keeps it off the
    #                                 ends of the ranges, where tanh lets no gradient through
    scan_pool: int = 1  # neighbouring beams whose mean enters the networks as one input; 1: each beam by itself
    layer_norm: bool = False  # normalise the critics' hidden layers
    bins: int = 0  # intervals of values that the critics tell apart as classes; 0: they regress
    value_low: float = -50.0  # ends of the range of values that these intervals divide
    value_high: float = 10.0
    bf16: bool = False  # compute the products of the hidden layers in bfloat16
    bc_alpha: float = 0.0  # > 0: TD3+BC (Fujimoto & Gu 2021), their alpha is 2.5

    def __post_init__(self):
        if self.bins and (self.bins == 1 or not self.value_low < self.value_high):
            raise LearnerError(
                "%d bins from %g to %g: give at least 2, and --value-low below --value-high"
                % (self.bins, self.value_low, self.value_high)
            )

    def check(self, observations: int, actions: int, scan: int) -> None:
        """Raises LearnerError if networks of these inputs and outputs cannot be built (arguments as for TD3)."""
        if self.scan_pool < 1 or (self.scan_pool > 1 and (scan < self.scan_pool or scan % self.scan_pool)):
            raise LearnerError("scan_pool is %r: give a divisor of the scan's %d beams" % (self.scan_pool, scan))
        if self.critics != 2 and not 2 < self.critics <= actions:
            raise LearnerError("critics is %r: give 2, or up to as many as actions (%d)" % (self.critics, actions))
        if self.symmetric and not 0 < scan < observations:
            raise LearnerError("symmetric: the observation has no scan and angle to mirror; leave --symmetric out")


class TD3:
    """The networks, their targets and optimisers, and one method: update."""

    def __init__(
        self,
        observations: int,
        actions: int,
        config: TD3Config = TD3Config(),
        seed: int = 0,
        device="cpu",
        scan: int = 0,
    ):
        """Fresh networks, drawn from `seed`.

        Args:
            observations: numbers of one observation.
            actions: numbers of one action.
            config: hyper-parameters.
            seed: of the networks' first weights.
            device: "cpu", "cuda" or "auto".
            scan: how many of the observation's first numbers are a scan; config.scan_pool neighbours are averaged.

        Raises:
            LearnerError: for an unknown device, a scan that config.scan_pool does not divide, too many critics, or a
                symmetric policy of observations without a scan.
        """
        self.config, self.actions, self.observations, self.scan = config, actions, observations, scan
        config.check(observations, actions, scan)
        self.features = observations - scan + scan // config.scan_pool
        self.device = _device(device)
        rng = np.random.default_rng(seed)
        hidden = list(config.hidden)
        self.values = _values(config, self.device)
        self.actor = MLP([self.features, *hidden, actions], rng, self.device, half=config.bf16)
        self.critics = [
            MLP(
                [self.features + actions, *hidden, self.values.outputs],
                rng,
                self.device,
                config.layer_norm,
                config.bf16,
            )
            for _ in range(config.critics)
        ]
        self.actor_target = self.actor.copy()
        self.critic_targets = [critic.copy() for critic in self.critics]
        self.actor_average = self.actor.copy() if config.average else None
        on_gpu = self.device.type == "cuda"
        self._critic_parameters = [p for critic in self.critics for p in critic.parameters]
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters, config.actor_lr, fused=True, capturable=on_gpu)
        self.critic_optimizer = torch.optim.Adam(
            self._critic_parameters, config.critic_lr, fused=True, capturable=on_gpu
        )
        self.updates = 0
        self.losses: Dict[str, torch.Tensor] = {}
        self._graphs = Graphs(self.step, config.policy_delay) if on_gpu else None

    @torch.no_grad()
    def begin_at(self, action: Sequence[float]) -> None:
        """Makes a fresh policy answer nearly this action, numbers in [-1, 1], to every observation.

        Raises:
            LearnerError: for another number of numbers than an action has.
        """
        if len(action) != self.actions:
            raise LearnerError("the policy is to begin at %d numbers: give %d" % (len(action), self.actions))
        nearly = torch.as_tensor(action, dtype=torch.float32, device=self.device).clamp(-INNER, INNER)
        for actor in filter(None, (self.actor, self.actor_target, self.actor_average)):
            weight, bias = actor.layers[-1]
            weight.mul_(SMALL_START)
            bias.copy_(torch.atanh(nearly))

    # -- learning ----------------------------------------------------------------------------------
    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """One gradient step of the critics; every policy_delay-th also of the policy and the targets."""
        self.updates += 1
        delayed = self.updates % self.config.policy_delay == 0
        if self._graphs is not None:
            self._graphs.run(batch, delayed)
        else:
            self.step(batch, delayed)

    def step(self, batch: Batch, delayed: bool) -> None:
        """The arithmetic of update (its own method so that a GPU can record it once and repeat it)."""
        if self.config.scan_pool > 1:
            batch = replace(
                batch,
                observation=self._pooled(batch.observation),
                next_observation=self._pooled(batch.next_observation),
            )
        self._update_critics(batch)
        if delayed:
            self._update_actor(batch)
            self._update_targets()

    def _pooled(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, observations) → (B, features): the means of `scan_pool` neighbouring beams, and the rest as it is."""
        if self.config.scan_pool == 1:
            return observation
        beams = observation[:, : self.scan].unflatten(1, (-1, self.config.scan_pool)).mean(2)
        return torch.cat((beams, observation[:, self.scan :]), 1)

    def _update_critics(self, batch: Batch) -> None:
        c = self.config
        # Target policy smoothing: noise in action units, clipped, and the action clipped to its range.
        noise = (batch.noise * c.target_noise).clamp_(-c.noise_clip, c.noise_clip)
        action = torch.tanh(self.actor_target.forward(batch.next_observation)).add_(noise).clamp_(-1.0, 1.0)
        # y = r + gamma^k Q'(s', a'), bootstrapping through time limits.
        there = torch.cat((batch.next_observation, action), 1)
        y = self._target(there, batch.noise).mul_(batch.discount[:, None]).add_(batch.reward[:, None])
        here = torch.cat((batch.observation, batch.action), 1)
        loss: Any = 0.0
        gradients: List[torch.Tensor] = []
        for critic in self.critics:
            kept: Kept = []
            error, gradient = self.values.error(critic.forward(here, kept), y)
            loss = loss + error
            gradients += critic.backward(kept, gradient)
        _apply(self.critic_optimizer, self._critic_parameters, gradients)
        self.losses["critic_loss"], self.losses["target_q"] = loss, y.mean()

    def _target(self, there: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """(B, 1): the lower value of the two target critics (clipped double Q).

        Of more than two, each transition draws the two anew (Chen et al. 2021, REDQ): by the order of its noise.
        """
        values = torch.cat([self.values.value(target.forward(there)) for target in self.critic_targets], 1)
        if values.shape[1] > 2:
            values = values.gather(1, noise[:, : values.shape[1]].argsort(1)[:, :2])
        return values.amin(1, keepdim=True)

    @property
    def _climbed(self) -> List[MLP]:
        """The critics whose mean value the policy climbs: the first of two (TD3), all of more (REDQ)."""
        return self.critics if len(self.critics) > 2 else self.critics[:1]

    def _update_actor(self, batch: Batch) -> None:
        kept: Kept = []
        z = self.actor.forward(batch.observation, kept)
        action = torch.tanh(z)
        # Deterministic policy gradient (the paper's eq. 2): climb Q, leaving its own weights alone.
        critics = self._climbed
        here = torch.cat((batch.observation, action), 1)
        outs: List[Tuple[Kept, torch.Tensor]] = []
        for critic in critics:
            kept_q: Kept = []
            outs.append((kept_q, critic.forward(here, kept_q)))
        q = sum(self.values.value(out) for _, out in outs) / len(critics)
        weight: Any = 1.0
        if self.config.bc_alpha > 0.0:
            weight = self.config.bc_alpha / q.abs().mean().clamp_(min=1e-6)
        dq = torch.full_like(q, -1.0 / len(q)) * weight / len(critics)
        da: Any = 0.0
        for critic, (kept_q, out) in zip(critics, outs):
            da = da + critic.input_gradient(kept_q, self.values.gradient(out, dq), slice(self.features, None))
        if self.config.bc_alpha > 0.0:
            da += (action - batch.action) * (2.0 / action.numel())
        dz = da * (1.0 - action * action)
        if self.config.saturation > 0.0:
            dz += z * (2.0 * self.config.saturation / z.numel())
        gradients = self.actor.backward(kept, dz)
        _apply(self.actor_optimizer, self.actor.parameters, gradients)
        self.losses["actor_q"] = q.mean()

    def _update_targets(self) -> None:
        pairs = [(self.actor, self.actor_target), *zip(self.critics, self.critic_targets)]
        online = [p for network, _ in pairs for p in network.parameters]
        target = [p for _, network in pairs for p in network.parameters]
        torch._foreach_lerp_(target, online, self.config.tau)
        if self.actor_average is not None:
            torch._foreach_lerp_(self.actor_average.parameters, self.actor.parameters, 1.0 - self.config.average)

    def report(self) -> Dict[str, float]:
        """Losses of the newest update as numbers (waits for the device)."""
        return {name: float(value) for name, value in self.losses.items()}

    # -- acting ------------------------------------------------------------------------------------
    @property
    def policy(self) -> MLP:
        """The policy that drives: the running average of the learnt one where there is one (it sways less)."""
        return self.actor_average or self.actor

    @torch.no_grad()
    def action(self, observation: np.ndarray) -> np.ndarray:
        """(n, observations) → (n, actions), without noise: the learnt policy, not its mean with its mirror image."""
        x = torch.as_tensor(observation, dtype=torch.float32, device=self.device)
        return torch.tanh(self.policy.forward(self._pooled(x))).cpu().numpy()

    def actor_weights(self) -> Weights:
        """The policy that is handed out, as policy/actor.py names it: "0.weight" (512, 729), "0.bias", ... Copies.

        With config.symmetric it is two networks side by side, along the first axis of each tensor.
        """
        weights = {name: tensor.cpu().numpy().copy() for name, tensor in self.policy.state().items()}
        if self.config.scan_pool > 1:  # a mean is linear: the first layer takes it over, and the file knows every beam
            first, sectors = weights["0.weight"], self.scan // self.config.scan_pool
            beams = np.repeat(first[:, :sectors] / np.float32(self.config.scan_pool), self.config.scan_pool, axis=1)
            weights["0.weight"] = np.concatenate((beams, first[:, sectors:]), axis=1)
        return side_by_side([weights, mirrored(weights, self.scan)]) if self.config.symmetric else weights

    # -- checkpoints -------------------------------------------------------------------------------
    def tensors(self) -> Dict[str, torch.Tensor]:
        """Everything that learning goes on from, by name; the tensors themselves."""
        result = {}
        for name, network in self._networks().items():
            result.update(network.state(name + "/"))
        for name, optimizer, parameters in self._optimizers():
            for i, p in enumerate(parameters):
                state = optimizer.state.get(p) or {}
                for key in ("exp_avg", "exp_avg_sq"):
                    result["%s/%d.%s" % (name, i, key)] = state.get(key, torch.zeros_like(p))
        return result

    def state(self) -> Tuple[Dict[str, np.ndarray], Dict[str, str]]:
        """(arrays, JSON-able header) for a checkpoint; load() is the inverse."""
        steps = {
            name: [float(o.state[p]["step"]) if p in o.state else 0.0 for p in parameters]
            for name, o, parameters in self._optimizers()
        }
        return (
            {name: t.detach().cpu().numpy().copy() for name, t in self.tensors().items()},
            {"updates": json.dumps(self.updates), "steps": json.dumps(steps), "shape": json.dumps(self.shape)},
        )

    @property
    def shape(self):
        """Sizes that a stored state must agree with: observation, hidden layers, action."""
        return [self.features, *self.config.hidden, self.actions]

    def load(self, arrays: Dict[str, np.ndarray], header: Dict[str, str], what: str = "checkpoint") -> None:
        """Takes over a state. Raises LearnerError, and changes nothing, where it belongs to another network."""
        shape = json.loads(header["shape"])
        if shape != self.shape:
            raise LearnerError(
                "%s holds a network of layers %s, this run's has %s; give the same --hidden" % (what, shape, self.shape)
            )
        mine = self.tensors()
        if self.actor_average is not None and "actor_average/0.weight" not in arrays:  # an average begins here
            arrays = dict(
                arrays,
                **{
                    name.replace("actor/", "actor_average/"): value
                    for name, value in arrays.items()
                    if name.startswith("actor/")
                },
            )
        for name, tensor in mine.items():
            if name not in arrays or arrays[name].shape != tuple(tensor.shape):
                raise LearnerError("%s: tensor %s is missing or has another shape" % (what, name))
            if not np.isfinite(arrays[name]).all():
                raise LearnerError("%s: tensor %s holds NaN or inf" % (what, name))
        steps = json.loads(header["steps"])
        for name, optimizer, parameters in self._optimizers():
            for i, p in enumerate(parameters):
                if p not in optimizer.state:
                    optimizer.state[p] = {
                        "step": torch.zeros((), dtype=torch.float32, device=self._step_device()),
                        "exp_avg": torch.zeros_like(p),
                        "exp_avg_sq": torch.zeros_like(p),
                    }
                optimizer.state[p]["step"].fill_(steps[name][i])
        for name, tensor in self.tensors().items():
            tensor.copy_(torch.from_numpy(arrays[name]))
        self.updates = json.loads(header["updates"])

    def _step_device(self):
        return self.device  # fused Adam keeps its step count beside the parameters

    def _networks(self):
        networks = {
            "actor": self.actor,
            **{"critic%d" % i: critic for i, critic in enumerate(self.critics, 1)},
            "actor_target": self.actor_target,
            **{"critic%d_target" % i: critic for i, critic in enumerate(self.critic_targets, 1)},
        }
        return networks if self.actor_average is None else dict(networks, actor_average=self.actor_average)

    def _optimizers(self):
        return (
            ("actor_adam", self.actor_optimizer, self.actor.parameters),
            ("critic_adam", self.critic_optimizer, self._critic_parameters),
        )


def _apply(optimizer, parameters, gradients) -> None:
    for parameter, gradient in zip(parameters, gradients):
        parameter.grad = gradient
    optimizer.step()


def _values(config: TD3Config, device: torch.device):
    if not config.bins:
        return Regression()
    return Classification(config.value_low, config.value_high, config.bins, device)


def _device(name) -> torch.device:
    try:
        device = torch.device(
            "cuda" if name == "auto" and torch.cuda.is_available() else "cpu" if name == "auto" else name
        )
    except RuntimeError:
        raise LearnerError("device %r is unknown; give cpu, cuda or auto" % (name,)) from None
    if device.type not in ("cpu", "cuda"):
        raise LearnerError("device %s: this program learns on cpu or cuda; give one of them, or auto" % (name,))
    if device.type == "cuda" and not torch.cuda.is_available():
        raise LearnerError("device cuda: torch finds no GPU here; give --device cpu")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise LearnerError("device %s: torch finds %d GPUs here, numbered from 0" % (name, torch.cuda.device_count()))
    return device
