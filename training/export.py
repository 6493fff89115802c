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
from typing import Dict, List, Optional

import numpy as np
from scipy.linalg import block_diag

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.policy.actor import Actor
from applr_ros1.policy.network import Layers
from training.storage import make_folder

LARGEST_DIFFERENCE = 1e-5


class ExportError(ApplrError):
    """An export that is not what it should be; one line."""


def to_onnx(actor: Actor) -> bytes:
    """An ONNX model: Gemm and Relu for each layer, Tanh at the end. The batch size is free."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    nodes, tensors, name = [], [], "observation"
    layers = as_one(actor.layers)
    last = len(layers) - 1
    for i, (weight, bias) in enumerate(layers):
        tensors += [
            numpy_helper.from_array(np.ascontiguousarray(weight), "%d.weight" % i),
            numpy_helper.from_array(np.ascontiguousarray(bias), "%d.bias" % i),
        ]
        nodes.append(helper.make_node("Gemm", [name, "%d.weight" % i, "%d.bias" % i], ["linear%d" % i], transB=1))
        name = "action" if i == last else "hidden%d" % i
        nodes.append(helper.make_node("Tanh" if i == last else "Relu", ["linear%d" % i], [name]))
    inputs, outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
    graph = helper.make_graph(
        nodes,
        "applr_actor",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", outputs])],
        tensors,
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 13)], producer_name="applr_ros1", ir_version=8
    )
    helper.set_model_props(model, _texts(actor))
    onnx.checker.check_model(model)
    return model.SerializeToString()


def as_one(layers: Layers) -> Layers:
    """Networks side by side as one network, whose hidden layers are as wide as theirs together; one as it is."""
    if layers[0][0].ndim == 2:
        return layers
    whole = [
        (block_diag(*weights) if i else np.concatenate(list(weights)), np.concatenate(list(biases)))
        for i, (weights, biases) in enumerate(layers)
    ]
    count, outputs = layers[-1][1].shape
    mean = np.tile(np.eye(outputs, dtype=np.float32), count) / np.float32(count)
    weight, bias = whole[-1]
    return [*whole[:-1], (mean @ weight, mean @ bias)]


def to_torchscript(actor: Actor) -> bytes:
    """A TorchScript module; its metadata is the extra file "metadata.json"."""
    import torch

    layers: List[torch.nn.Module] = []
    for weight, bias in as_one(actor.layers):
        layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            layer.weight.copy_(torch.tensor(weight))
            layer.bias.copy_(torch.tensor(bias))
        layers += [layer, torch.nn.ReLU()]
    layers[-1] = torch.nn.Tanh()
    script = torch.jit.script(torch.nn.Sequential(*layers).eval())
    buffer = io.BytesIO()
    torch.jit.save(script, buffer, _extra_files={"metadata.json": json.dumps(_texts(actor))})
    return buffer.getvalue()


def difference(actor: Actor, onnx_bytes: Optional[bytes] = None, torchscript_bytes: Optional[bytes] = None) -> float:
    """Largest difference to the actor's own actions, over random observations, alone and in a batch."""
    observations = np.random.default_rng(0).uniform(-1, 1, (64, actor.layers[0][0].shape[-1])).astype(np.float32)
    runs = []
    if onnx_bytes is not None:
        import onnxruntime

        session = onnxruntime.InferenceSession(onnx_bytes, providers=["CPUExecutionProvider"])
        runs.append(lambda x: session.run(["action"], {"observation": x})[0])
    if torchscript_bytes is not None:
        import torch

        module = torch.jit.load(io.BytesIO(torchscript_bytes))
        runs.append(lambda x: module(torch.from_numpy(x)).detach().numpy())
    return max(float(np.abs(run(x) - actor.action(x)).max()) for run in runs for x in (observations, observations[:1]))


def export(path, folder) -> Dict[str, str]:
    """Writes NAME.onnx and NAME.pt beside each other; returns {format: file}."""
    actor, folder = Actor.load(path, None), make_folder(folder)
    stem, written = Path(path).stem, {}
    for kind, suffix, data in (("onnx", ".onnx", to_onnx(actor)), ("torchscript", ".pt", to_torchscript(actor))):
        apart = difference(actor, **{kind + "_bytes": data})
        if not apart <= LARGEST_DIFFERENCE:
            raise ExportError("%s differs from %s by %g; nothing was written" % (kind, path, apart))
        write_bytes(folder / (stem + suffix), data)
        written[kind] = str(folder / (stem + suffix))
    return written


def _texts(actor: Actor) -> Dict[str, str]:
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in actor.metadata.items()}


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the command; returns the exit status."""
    return run_main(lambda: run(without_remappings(arguments)), "export")


def run(arguments: List[str]) -> int:
    """Exports as the arguments (ACTOR FOLDER) say."""
    if len(arguments) != 2 or "--help" in arguments or "-h" in arguments:
        print(__doc__)
        return 0 if {"--help", "-h"} & set(arguments) else 2
    try:
        for kind, path in export(*arguments).items():
            print("%-12s %s" % (kind, path))
    except ImportError as error:
        raise ExportError("%s is not installed; ./applr setup brings it" % error.name) from None
    return 0


if __name__ == "__main__":
    sys.exit(main())
