"""Policies from files: Policy, a network with an encoding, and APPLD's ContextPolicy.

A file is in safetensors format. It holds a multilayer perceptron, and metadata as JSON in its
header. An ensemble of networks of the same size is stacked along the first axis of each tensor, and
its output is the mean of their outputs. `load` is the only reader. The trainer writes with `save`,
training/appld with `save_contexts`. Nothing is unpickled.
"""

from __future__ import annotations

import json
import logging
import os
from typing import Any, Dict, List, Mapping, Optional, Tuple, Union

import numpy as np
import safetensors.numpy

from applr_ros1.common import files
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.common.tensors import unpack
from applr_ros1.policy.decision import Context, Metadata, Method
from applr_ros1.policy.dimensionless import DIMENSIONLESS, ENCODINGS
from applr_ros1.policy.encoding import (
    PAPER,
    Encoding,
    Mirror,
    PaperEncoding,
    check_robot,
    with_mirror_images,
)
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE, Space, obstacle_range_of, space_of
from applr_ros1.robots import JACKAL, Robot

# Format names in the files of both policies
_LOGGER = logging.getLogger(__name__)
FORMAT = "applr-actor-2"
CONTEXTS_FORMAT = "applr-appld-1"
# Metadata in plain text instead of JSON; only older files have sha256.
PLAIN_ENTRIES = ("format", "sha256")
Weights = Mapping[str, Array32]
Layers = List[Tuple[Array32, Array32]]


class _FromFile(Method):
    """Method that is loaded from a file.

    Attributes:
        path: Path of the file; "" if there is none.
        metadata: Metadata of the file, {str: JSON value}.
    """

    redraws_stalled = False
    path = ""
    metadata: Metadata = {}

    def describe(self) -> Dict[str, Any]:
        """Return the policy's class, file name and checksum."""
        description = {"class": type(self).__name__}
        if self.path:
            description["file"] = os.path.basename(self.path)
            description["sha256"] = files.sha256(files.read_bytes(self.path))
        return description


class Policy(_FromFile):
    """Deterministic policy network for one robot: ReLU layers, and tanh at the output.

    Args:
        encoding: Encoding of observations and actions.
        layers: Layers of the network (layers_of).
        metadata: Metadata of the policy's file, {str: JSON value}.
    """

    def __init__(self, encoding: Encoding, layers: Layers, metadata: Optional[Metadata] = None):
        self.encoding = encoding
        self.layers = layers
        self.metadata = metadata or {}
        self.period = float(encoding.period)
        self.space = encoding.space
        self.layout = encoding.layout
        self.redraws_stalled = encoding.redraws_stalled
        self.reset(0)

    @classmethod
    def of(
        cls,
        weights: Weights,
        encoding: Optional[Encoding] = None,
        metadata: Optional[Metadata] = None,
    ) -> Policy:
        """Make a policy from the tensors of its network.

        Raises ApplrError if they do not fit the encoding.

        Args:
            weights: {"0.weight": (512, 729), "0.bias": (512,), "1.weight": ..., last (8, 512)}
                float32.
            encoding: Encoding of observations and actions; None for the paper's encoding for the
                Jackal.
            metadata: Metadata of the policy's file, {str: JSON value}.
        """
        encoding = encoding or PaperEncoding(JACKAL)
        layers = _fitting(weights, encoding.size, encoding.actions)
        # A file does not store the mirror images.
        if metadata and metadata.get("with_mirror_images"):
            layers = layers_of(with_mirror_images(weights, encoding.mirror))
        return cls(encoding, layers, metadata)

    @property
    def environment(self) -> Dict[str, Any]:
        """Arguments of the Gymnasium environment Navigation-v0 for this policy's encoding."""
        return {
            "robot": self.encoding.robot.folder,
            "observation": self.encoding.name,
            "period": self.period,
            "base": self.encoding.base,
            "obstacle_range": self.obstacle_range,
        }

    def reset(self, seed: int) -> None:
        """Forget the previous decisions at the start of a course."""
        self.encoding.period = self.period  # The node's ~period may have changed the period.
        self.encoding.forget_decision()

    def action(self, observation: Any) -> Array32:
        """Return the action (m,) or (k, m) float32 in [-1, 1] for observations (n,) or (k, n).

        NaN is propagated.
        """
        return np.tanh(forward(self.layers, observation))

    def theta(self, context: Optional[Context]) -> Array:
        """Return the parameters (n,) of a decision, which the Pilot clips.

        Raises ApplrError on NaN or inf.
        """
        if context is None:
            raise ApplrError("a policy needs an observation to decide on")
        return self.encoding.theta(self.action(self.encoding.observe(context)))

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> Tuple[Array32, Any]:
        """Return actions (m,) or (k, m) for observations (n,) or (k, n), as stable-baselines3 does.

        The policy is deterministic and has no memory: `state` is returned unchanged, other
            arguments are ignored.
        """
        return self.action(observation), state


class ContextPolicy(_FromFile):
    """APPLD's policy: a parameter set per context, and a classifier of scans by context.

    Args:
        contexts: {name: theta (m,)}, values of space.chosen, the parameters that the paper's
            encoding sets; clipped.
        weights: {"0.weight": (h, 720), "0.bias": (h,), ..., last (c, h)} float32 for c contexts.
            The ReLU layers take the scan of the paper's observation. The index of the largest
            output is the context.
        space: Parameter space of the robot.
        layout: Layout of the scan, which determines the number of inputs.
    """

    def __init__(self, contexts: Weights, weights: Weights, space: Space, layout: Layout):
        self.names = list(contexts)
        self.space = space
        self.layout = layout
        parameter_sets = [space.fill(space.chosen.clip(theta)) for theta in contexts.values()]
        self.sets = np.array(parameter_sets)  # (contexts, n)
        self.layers = _fitting(weights, layout.beams, len(self.names))

    @classmethod
    def of(cls, weights: Weights, metadata: Metadata, robot: Robot) -> ContextPolicy:
        """Make the policy from a file's tensors and metadata.

        Raises ApplrError if they are for another robot.
        """
        space = space_of(robot)
        check_robot(metadata, robot)
        if metadata["names"] != list(space.chosen.names):
            needed_names = ", ".join(space.chosen.names)
            raise ApplrError(
                f"its parameters are {shown(metadata['names'])}: {needed_names} are needed"
            )
        contexts = {str(entry["name"]): entry["theta"] for entry in metadata["contexts"]}
        return cls(contexts, weights, space, Layout.from_dict(metadata["layout"]))

    def context(self, observation: Any) -> int:
        """Return the index of the context for an observation (729,) or its first 720 entries."""
        scan = np.asarray(observation, dtype=np.float32)[: self.layout.beams]
        return int(np.argmax(forward(self.layers, scan)))

    def theta(self, context: Optional[Context]) -> Array:
        """Return the parameter set of the context that is predicted from the scan."""
        if context is None:
            raise ApplrError("a policy needs an observation to decide on")
        return np.array(self.sets[self.context(context.observation)])


def load(
    path: Union[str, "os.PathLike[str]"], robot: Robot = JACKAL
) -> Union[Policy, ContextPolicy]:
    """Read a policy from its file, for a robot. The layout of the scan comes from the file.

    Args:
        path: Path of the file.
        robot: Robot to drive. A policy with contexts or in the paper's encoding must have been made
            for this robot.

    Raises:
        ApplrError: The file is missing, or made for another robot or parameter space.
    """
    path = os.fspath(path)
    policy: Union[Policy, ContextPolicy]
    with files.reading(path):
        weights, header = unpack(files.read_bytes(path), path)
        file_format = header.get("format")
        if file_format not in (FORMAT, CONTEXTS_FORMAT):
            problem = f"unknown policy format {shown(file_format)}"
            raise ApplrError(f"{problem}: give a file written by ./applr train or appld.py")
        metadata = {}
        for entry_name, json_text in header.items():
            if entry_name not in PLAIN_ENTRIES:
                metadata[entry_name] = json.loads(json_text)
        if file_format == CONTEXTS_FORMAT:
            policy = ContextPolicy.of(weights, metadata, robot)
        else:
            # Files in the paper's encoding have no entry for the version of their observation.
            encoding_name = DIMENSIONLESS if "observation" in metadata else PAPER
            encoding = ENCODINGS[encoding_name].of(metadata, robot)
            policy = Policy.of(weights, encoding, metadata)
            policy.obstacle_range = obstacle_range_of(metadata)
    policy.metadata = metadata
    policy.path = path
    _LOGGER.info("policy %s for %s", path, robot.name)
    return policy


def save(
    path: Union[str, "os.PathLike[str]"],
    weights: Weights,
    metadata: Optional[Metadata] = None,
    encoding: Optional[Encoding] = None,
) -> None:
    """Write a policy to a file atomically: to a temporary file beside it, which is then renamed.

    Args:
        path: Path of the file.
        weights: Tensors as for Policy.of. If every second network of an ensemble is the mirror
            image of the previous one, the mirror images are not stored.
        metadata: {str: JSON value}: "period_s" for the paper's encoding, "training", "result",
            "obstacle_range" (Method.obstacle_range), or others.
        encoding: Encoding of observations and actions; None for the paper's encoding for the
            Jackal.
    """
    encoding = encoding or PaperEncoding(JACKAL)
    weights = _float32(weights)
    Policy.of(weights, encoding)  # Raises ApplrError if the weights do not fit the encoding.
    metadata = {**(metadata or {}), **encoding.to_metadata()}
    stored_weights = _without_mirror_images(weights, encoding.mirror)
    if stored_weights is not None:
        weights = stored_weights
        metadata["with_mirror_images"] = True
    _write(path, weights, FORMAT, metadata)


def save_contexts(
    path: Union[str, "os.PathLike[str]"],
    contexts: Weights,
    weights: Weights,
    metadata: Optional[Metadata] = None,
    space: Space = SPACE,
    layout: Layout = LAYOUT,
) -> None:
    """Write a ContextPolicy to a file.

    The arguments and errors are those of ContextPolicy and `save`.
    """
    weights = _float32(weights)
    # Raises ApplrError if the weights do not fit the contexts.
    ContextPolicy(contexts, weights, space, layout)
    entries = []
    for context_name, theta in contexts.items():
        entries.append({"name": context_name, "theta": list(map(float, theta))})
    metadata = {
        **(metadata or {}),
        "robot": space.robot,
        "names": space.chosen.names,
        "layout": layout.to_dict(),
        "contexts": entries,
    }
    _write(path, weights, CONTEXTS_FORMAT, metadata)


def _without_mirror_images(weights: Weights, mirror: Mirror) -> Optional[Dict[str, Array32]]:
    """Return every second network if the others are their mirror images, else None."""
    if weights["0.weight"].ndim != 3:
        return None
    original_networks = {
        tensor_name: np.ascontiguousarray(tensor[::2]) for tensor_name, tensor in weights.items()
    }
    for tensor_name, tensor in with_mirror_images(original_networks, mirror).items():
        if not np.array_equal(tensor, weights[tensor_name]):
            return None
    return original_networks


def _write(path: Any, weights: Dict[str, Array32], file_format: str, metadata: Metadata) -> None:
    """Write tensors and metadata to a file of a format."""
    header = {entry_name: json.dumps(entry) for entry_name, entry in metadata.items()}
    header["format"] = file_format
    files.write_bytes(path, safetensors.numpy.save(weights, metadata=header))


def _float32(weights: Weights) -> Dict[str, Array32]:
    """Return tensors as safetensors writes them: it takes the memory as it is, without strides."""
    return {name: np.ascontiguousarray(tensor, np.float32) for name, tensor in weights.items()}


def layers_of(weights: Weights) -> Layers:
    """Return the layers of a network.

    Those of an ensemble of k networks have an additional first axis of size k.

    Args:
        weights: {"0.weight": (h, inputs), "0.bias": (h,), "1.weight": ..., the last (outputs, h)}.
    """
    return [(weights[f"{i}.weight"], weights[f"{i}.bias"]) for i in range(len(weights) // 2)]


def _fitting(weights: Weights, inputs: int, outputs: int) -> Layers:
    """Return the layers of a network.

    Raises ApplrError if its number of inputs or outputs, or the type of its numbers, is wrong.
    """
    for tensor_name, tensor in weights.items():
        if tensor.dtype != np.float32:
            raise ApplrError(f"its tensor {tensor_name} is {tensor.dtype}: float32 is needed")
    layers = layers_of(weights)
    first_weight, _ = layers[0]
    last_weight, _ = layers[-1]
    actual_sizes = (first_weight.shape[-1], last_weight.shape[-2])
    if actual_sizes != (inputs, outputs):
        raise ApplrError(
            f"its network has {actual_sizes} inputs and outputs: {(inputs, outputs)} are needed"
        )
    forward(layers, np.zeros(inputs))  # Raises ValueError unless each layer fits the previous one.
    return layers


def forward(layers: Layers, x: Any) -> Array32:
    """Return the network's output before a final activation for x (n, inputs) or (inputs,).

    NaN is propagated.
    """
    x = np.asarray(x, dtype=np.float32)
    is_ensemble = layers[0][0].ndim == 3
    activations: Array32 = x
    if is_ensemble:
        activations = np.atleast_2d(x)
    for layer_index, (weight, bias) in enumerate(layers):
        if layer_index:
            activations = np.maximum(activations, np.float32(0.0))
        # In an ensemble, weight is (k, out, in) and bias (k, out), so that activations
        # become (k, n, out).
        if is_ensemble:
            bias = bias[:, None, :]
        activations = activations @ weight.swapaxes(-1, -2) + bias
    if not is_ensemble:
        return activations
    # The mean before tanh keeps a network and its mirror image symmetric.
    outputs: Array32 = activations.mean(axis=0)
    return outputs.reshape(*x.shape[:-1], -1)
