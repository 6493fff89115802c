"""What a policy file holds beside its robot: the network's tensors by name, and what the file says about itself."""

from __future__ import annotations

from typing import Any, Dict

from applr_ros1.policy.actor import Actor, GeneralActor
from training.td3.networks import Weights

POLICY_FILE = ".safetensors"  # how the name of a policy's file ends


def weights_of(actor: Actor) -> Weights:
    """The tensors of an actor by their names in a file."""
    layers = enumerate(actor.layers)
    return {f"{i}.{k}": tensor for i, layer in layers for k, tensor in zip(("weight", "bias"), layer)}


def stated(actor: Actor) -> Dict[str, Any]:
    """What a policy file says about itself beyond what `save` adds."""
    kept = {key: actor.metadata[key] for key in ("training", "default") if key in actor.metadata}
    return dict(kept, period_s=actor.period)


def begun_policy(path: str) -> Weights:
    """The network in the file of a policy in the dimensionless form, without its mirror image. Raises ApplrError."""
    layers = GeneralActor.load(path).layers
    single = [tuple(tensor[0] if weight.ndim == 3 else tensor for tensor in (weight, bias)) for weight, bias in layers]
    return {f"{i}.{kind}": t for i, pair in enumerate(single) for kind, t in zip(("weight", "bias"), pair)}
