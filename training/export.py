"""Writes a trained policy as ONNX for other programs: `python -m training.export actor.safetensors actor.onnx`.

The model takes "observation" (n, 729) float32 and returns "action" (n, 8) in [-1, 1], with other numbers for other
robots than the Jackal; the metadata are included. It is compared with the policy: a difference over 1e-5 is an error.
"""

from __future__ import annotations

import json
import sys
from typing import List, Optional, Union

import numpy as np

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import write_bytes
from applr_ros1.policy.actor import Actor, GeneralActor, load
from training.common.command_line import parsed
from training.common.options import Options, argument

with extra(__name__):
    import onnxruntime
    import torch

LARGEST_DIFFERENCE = 1e-5
Policy = Union[Actor, GeneralActor]


class Network(torch.nn.Module):
    """An actor's networks as a torch module: observations (n, inputs) to actions (n, outputs)."""

    def __init__(self, actor: Policy):
        super().__init__()
        tensors = [torch.tensor(tensor) for layer in actor.layers for tensor in layer]
        self.tensors = torch.nn.ParameterList(torch.nn.Parameter(tensor, requires_grad=False) for tensor in tensors)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """The actions. Of networks side by side the mean of their outputs before tanh counts."""
        tensors = list(self.tensors)
        for i in range(0, len(tensors), 2):
            weight, bias = tensors[i], tensors[i + 1]
            x = (torch.relu(x) if i else x) @ weight.mT + (bias[:, None] if weight.ndim == 3 else bias)
        return torch.tanh(x.mean(dim=0) if x.ndim == 3 else x)


def to_onnx(actor: Policy) -> bytes:
    """An ONNX model. The batch size is free."""
    program = torch.onnx.export(
        Network(actor).eval(),
        (torch.zeros(2, actor.layers[0][0].shape[-1]),),
        input_names=["observation"],
        output_names=["action"],
        dynamic_shapes=({0: torch.export.Dim("n")},),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in actor.metadata.items()}
    program.model.metadata_props.update(texts)
    return program.model_proto.SerializeToString()


def difference(actor: Policy, model: bytes) -> float:
    """Largest difference of an ONNX model to the actor itself, over random observations, alone and in a batch."""
    observations = np.random.default_rng(0).uniform(-1, 1, (64, actor.layers[0][0].shape[-1])).astype(np.float32)
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    return max(
        float(np.abs(session.run(["action"], {"observation": x})[0] - actor.action(x)).max())
        for x in (observations, observations[:1])
    )


class ExportOptions(Options):
    """What to export."""

    policy: str = argument("Policy file to export, of any robot.")
    out: str = argument("ONNX file to write.")


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake."""
    return run_main(lambda: run(parsed(ExportOptions, "python -m training.export", __doc__, arguments)), "export")


def run(options: ExportOptions) -> None:
    """Exports a policy."""
    actor = load(options.policy, None)
    model = to_onnx(actor)
    apart = difference(actor, model)
    if not apart <= LARGEST_DIFFERENCE:
        raise ApplrError(f"the model differs from {options.policy} by {apart:g}; nothing was written")
    write_bytes(options.out, model)
    print(f"{options.out}: written")


if __name__ == "__main__":
    sys.exit(main())
