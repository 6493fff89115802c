"""The actor pi(s) → a: a multilayer perceptron in numpy, read from a safetensors file.

Called by the applr node and by evaluation; the trainer writes such files with `save`. Nothing is unpickled,
sizes are bounded, and every way in which a file can be wrong is one line.
"""

import hashlib
import json
import os
import struct

import numpy as np
import safetensors.numpy

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import observation
from applr_ros1.policy.decision import period_of
from applr_ros1.policy.parameter_space import SPACE

FORMAT = "applr-actor-1"
MAX_BYTES = 256 * 2**20  # a 3 x 512 actor has 3.6 MB
MAX_HEADER = 2**20
MAX_LAYERS = 16


class ActorError(ApplrError):
    """An actor file that cannot be read, used or written; one line with what, why and the remedy."""


class Actor:
    """A deterministic policy: ReLU layers and tanh at the end (the paper's has three hidden layers of 512).

    weights: {"0.weight": (512, 729), "0.bias": (512,), "1.weight": ..., last (8, 512)} float32.
    """

    def __init__(self, weights, space=SPACE, metadata=None):
        self.layers = _layers(weights, observation.BEAMS + 1 + len(space), len(space), "actor")
        self.space = space
        self.metadata = metadata or {}
        self.period = period_of(self.metadata)

    @classmethod
    def load(cls, path, space=SPACE):
        """Reads an actor file. Raises ActorError when it is absent, damaged, too big, of other shapes, made
        for another parameter space or observation, or when its checksum is wrong.
        """
        path = os.fspath(path)
        weights, metadata = _read(path)
        _compare(path, "parameter space", metadata.get("space"), json.loads(space.to_json()))
        _compare(path, "observation", metadata.get("layout"), observation.LAYOUT)
        _layers(weights, observation.BEAMS + 1 + len(space), len(space), path)
        try:
            return cls(weights, space, metadata)
        except ValueError as e:
            raise ActorError(f"{path}: {e}") from None

    def action(self, obs):
        """obs (729,) or (n, 729) float32 → action (8,) or (n, 8) float32 in [-1, 1]. NaN goes through."""
        x = np.asarray(obs, dtype=np.float32)
        for weight, bias in self.layers[:-1]:
            x = np.maximum(x @ weight.T + bias, np.float32(0.0))
        weight, bias = self.layers[-1]
        return np.tanh(x @ weight.T + bias)

    def theta(self, obs):
        """obs (729,) → theta (8,): scaled to the ranges, counts rounded. Raises SpaceError on NaN or inf."""
        return self.space.to_theta(self.action(obs))


def save(path, weights, metadata=None, space=SPACE):
    """Writes an actor file, whole or not at all (a temporary file beside it, then renamed).

    weights: as in Actor; metadata: {str: JSON value}, e.g. "training" and "result". Space, layout and
    checksum are added. Raises ActorError.
    """
    weights = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in weights.items()}
    _layers(weights, observation.BEAMS + 1 + len(space), len(space), "actor to save")
    header = {key: json.dumps(value) for key, value in (metadata or {}).items()}
    header.update(format=FORMAT, space=space.to_json(), layout=json.dumps(observation.LAYOUT), sha256=checksum(weights))
    files.write_bytes(path, safetensors.numpy.save(weights, metadata=header), ActorError)


def checksum(weights):
    """sha256 (hex) over names, shapes, types and bytes of the tensors, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        value = np.ascontiguousarray(weights[name])
        digest.update(f"{name} {value.shape} {value.dtype.name}\n".encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def _read(path):
    """(weights, metadata) of a safetensors file whose structure, sizes and checksum hold; else ActorError."""
    data = files.read_bytes(path, MAX_BYTES, ActorError)
    if data[:2] in (b"PK", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"):
        raise ActorError(f"{path}: a pickle, not a safetensors file; nothing of it was executed")
    if len(data) < 10:
        raise ActorError(f"{path}: truncated ({len(data)} bytes); copy the file again")
    (length,) = struct.unpack("<Q", data[:8])
    if length > MAX_HEADER:
        raise ActorError(
            f"{path}: not a safetensors file (its header would be {length} bytes); give a file that train.py wrote"
        )
    try:
        header = json.loads(data[8 : 8 + length].decode("utf-8")).get("__metadata__") or {}
        metadata = {key: _value(text) for key, text in header.items()}
        weights = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, ValueError, AttributeError, KeyError, TypeError, RecursionError) as e:
        why = str(e).splitlines()[0]
        raise ActorError(f"{path}: truncated or damaged ({why}); copy the file again") from None
    if metadata.get("format") != FORMAT:
        raise ActorError(
            f"{path}: no actor of ours (format {metadata.get('format')!r}, expected {FORMAT!r}); "
            "give a file that train.py wrote"
        )
    if metadata.get("sha256") != checksum(weights):
        raise ActorError(f"{path}: checksum of the weights is wrong; the file was damaged or changed, copy it again")
    return weights, metadata


def _value(text):
    """A metadata entry: JSON where it is JSON, else the plain string (format, sha256)."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def _layers(weights, inputs, outputs, path):
    """[(weight, bias), ...] after checking names, types, shapes and values."""
    layers, width = [], inputs
    count = len(weights) // 2
    names = {f"{i}.{kind}" for i in range(count) for kind in ("weight", "bias")}
    if not 1 <= count <= MAX_LAYERS or set(weights) != names:
        raise ActorError(
            f"{path}: tensors are {', '.join(sorted(weights)[:6])}...: 0.weight, 0.bias, 1.weight... needed"
        )
    for i in range(count):
        weight, bias = weights[f"{i}.weight"], weights[f"{i}.bias"]
        rows = outputs if i == count - 1 else weight.shape[0]
        if weight.shape != (rows, width) or bias.shape != (rows,):
            raise ActorError(
                f"{path}: layer {i} has shapes {weight.shape} and {bias.shape}, ({rows}, {width}) and ({rows},) needed"
            )
        if weight.dtype != np.float32 or bias.dtype != np.float32:
            raise ActorError(f"{path}: layer {i} is {weight.dtype}, float32 needed")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ActorError(f"{path}: layer {i} holds NaN or inf; train or copy it again")
        layers.append((weight, bias))
        width = rows
    return layers


def _compare(path, what, found, expected):
    if not isinstance(found, dict):
        raise ActorError(
            f"{path}: its metadata name no {what}; it was not written by this package, give a file that train.py wrote"
        )
    for key, value in expected.items():
        if found.get(key) != value:
            raise ActorError(
                f"{path}: made for another {what}: {key} is {_short(found.get(key))}, "
                f"here {_short(value)}; train one for this {what}"
            )


def _short(value):
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
