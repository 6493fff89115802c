"""Writes a trained policy as ONNX and TorchScript for other programs.

`python -m training.export actor.safetensors OUT_FOLDER`. Both take "observation" (n, 729) float32 and return "action"
(n, 8) in [-1, 1], with other numbers for other robots than the Jackal; the metadata are included. The result is
compared with the policy: a difference over 1e-5 is an error.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Dict, List, Optional, Union

import numpy as np
import torch

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.policy.actor import Actor, GeneralActor, load
from training.common.command_line import parsed
from training.common.folders import make_folder
from training.common.options import Options, argument

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
    seen = torch.zeros(2, actor.layers[0][0].shape[-1])
    program = torch.onnx.export(
        Network(actor).eval(),
        (seen,),
        input_names=["observation"],
        output_names=["action"],
        dynamic_shapes=({0: torch.export.Dim("n")},),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    program.model.metadata_props.update(_texts(actor))
    return program.model_proto.SerializeToString()


def to_torchscript(actor: Policy) -> bytes:
    """A TorchScript module; its metadata is the extra file "metadata.json"."""
    script = torch.jit.trace(Network(actor), torch.zeros(2, actor.layers[0][0].shape[-1]))
    buffer = io.BytesIO()
    torch.jit.save(script, buffer, _extra_files={"metadata.json": json.dumps(_texts(actor))})
    return buffer.getvalue()


def difference(actor: Policy, onnx_bytes: Optional[bytes] = None, torchscript_bytes: Optional[bytes] = None) -> float:
    """Largest difference to the actor's own actions, over random observations, alone and in a batch."""
    observations = np.random.default_rng(0).uniform(-1, 1, (64, actor.layers[0][0].shape[-1])).astype(np.float32)
    runs = []
    if onnx_bytes is not None:
        import onnxruntime

        session = onnxruntime.InferenceSession(onnx_bytes, providers=["CPUExecutionProvider"])
        runs.append(lambda x: session.run(["action"], {"observation": x})[0])
    if torchscript_bytes is not None:
        module = torch.jit.load(io.BytesIO(torchscript_bytes))
        runs.append(lambda x: module(torch.from_numpy(x)).detach().numpy())
    return max(float(np.abs(run(x) - actor.action(x)).max()) for run in runs for x in (observations, observations[:1]))


def export(path, folder) -> Dict[str, str]:
    """Writes NAME.onnx and NAME.pt beside each other; returns {format: file}."""
    folder = make_folder(folder)
    actor = load(path, None)
    stem, written = Path(path).stem, {}
    for kind, suffix, data in (("onnx", ".onnx", to_onnx(actor)), ("torchscript", ".pt", to_torchscript(actor))):
        apart = difference(actor, **{kind + "_bytes": data})
        if not apart <= LARGEST_DIFFERENCE:
            raise ApplrError(f"{kind} differs from {path} by {apart:g}; nothing was written")
        write_bytes(folder / (stem + suffix), data)
        written[kind] = str(folder / (stem + suffix))
    return written


def _texts(actor: Policy) -> Dict[str, str]:
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in actor.metadata.items()}


class ExportOptions(Options):
    """What to export."""

    policy: str = argument("Policy file to export, of any robot.")
    folder: str = argument("Folder to write NAME.onnx and NAME.pt to.")


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake."""
    return run_main(lambda: run(parsed(ExportOptions, "python -m training.export", __doc__, arguments)), "export")


def run(options: ExportOptions) -> None:
    """Exports a policy and prints the files."""
    for kind, path in export(options.policy, options.folder).items():
        print(f"{kind:12} {path}")


if __name__ == "__main__":
    sys.exit(main())
