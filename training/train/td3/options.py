"""Options of TD3: network sizes, learning rates and penalties. td3.py applies them."""

from __future__ import annotations

from typing import Annotated, List

from pydantic import ConfigDict, Field

from training.common.options import Options, option


class TD3Options(Options):
    """Options of TD3 and of the extensions in td3.py."""

    model_config = ConfigDict(title="TD3")

    # fmt: off
    net_arch: List[Annotated[int, Field(ge=1, le=8192)]] = option([512, 512, 512],
        "Sizes of the hidden layers of the policy and of both critics.",
        min_length=1, max_length=15)
    critic_lr: float = option(1e-3, "Learning rate of the critics.", ge=0, le=1)
    gamma: float = option(0.95, "Discount factor per decision.", ge=0, le=1)
    batch_size: int = option(256,
        "Number of transitions in the batch of a gradient step.", ge=1, le=65536)
    policy_ema_decay: float = option(0.0,
        "Decay per policy step of a running average of the policy, such as 0.999; actors and "
        "actor files then hold the average. 0 uses the policy itself.", ge=0, le=0.999999)
    symmetric: bool = option(False,
        "Give actors and actor files the mean of the policy and its mirror image, which is "
        "exactly symmetric, as robot and planner are. The learnt policy alone is only "
        "approximately symmetric.")
    smoothness: List[Annotated[float, Field(ge=0, le=1000)]] = option([0.0],
        "Weight of a penalty on the mean square change of the policy's action between the two "
        "observations of a transition, for actions from -1 to 1. Several numbers weight the "
        "parameters one by one. 0 disables the penalty.",
        min_length=1)
    preactivation_l2: float = option(0.0,
        "Weight of a penalty on the mean square of the policy's outputs before tanh. The penalty "
        "keeps actions away from the ends of the ranges, at which the gradient of tanh vanishes. "
        "0 disables it.", ge=0, le=100)
    layer_norm: bool = option(False,
        "Normalise the hidden layers of the critics, which keeps many gradient steps per "
        "transition stable.")
    bc_alpha: float = option(0.0,
        "Alpha of TD3+BC (Fujimoto and Gu 2021), which keeps the policy close to the actions of "
        "the dataset; its authors use 2.5. Online, the policy stays close to the actions driven "
        "so far. 0 is plain TD3.", ge=0, le=1000)
    # fmt: on
