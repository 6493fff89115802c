"""The network in a policy file, with which a training begins."""

from __future__ import annotations

from applr_ros1.policy.actor import GeneralActor, load
from training.td3.networks import Weights

POLICY_FILE = ".safetensors"  # how the name of a policy's file ends


def begun_policy(path: str) -> Weights:
    """The network in the file of a policy in the dimensionless form, without its mirror image. Raises ApplrError."""
    layers = load(path, kinds=[GeneralActor]).layers
    single = [tuple(tensor[0] if weight.ndim == 3 else tensor for tensor in (weight, bias)) for weight, bias in layers]
    return {f"{i}.{kind}": t for i, pair in enumerate(single) for kind, t in zip(("weight", "bias"), pair)}
