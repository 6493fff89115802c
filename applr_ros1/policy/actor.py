"""The actor pi(s) → a: a multilayer perceptron in numpy, read from a safetensors file.

Called by the applr node and by evaluation; the trainer writes such files with `save`. Nothing is unpickled,
sizes are bounded, and every way in which a file can be wrong is one line. `python -m applr_ros1.policy.actor FILE ...`
gives files of an earlier version, whose checksum is of the weights alone, the checksum of today.
"""

import json
import os
import sys

import numpy as np
import safetensors.numpy

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.tensors import checksum, unpack
from applr_ros1.policy import encoding
from applr_ros1.policy.decision import period_of
from applr_ros1.policy.layout import Layout, ObservationError
from applr_ros1.policy.network import Mirror, forward, layers_of, with_mirror_images
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE, Space

FORMAT, BEFORE = "applr-actor-2", "applr-actor-1"
MAX_BYTES = 256 * 2**20  # a 3 x 512 actor has 3.6 MB


class Actor:
    """A deterministic policy: ReLU layers and tanh at the end (the paper's has three hidden layers of 512).

    weights: {"0.weight": (512, 729), "0.bias": (512,), "1.weight": ..., last (8, 512)} float32. layout: the Layout of
    its observations; those have 729 numbers for the Jackal.
    """

    def __init__(self, weights, space=SPACE, metadata=None, layout=LAYOUT):
        self.space, self.layout = space.paper, layout
        self.layers = _layers(weights, self.space, layout, "actor")
        self.metadata = metadata or {}
        self.period = period_of(self.metadata)

    @classmethod
    def load(cls, path, space=SPACE):
        """Read an actor file. How it sees a scan is its own: see `layout`.

        Args:
            path: The file.
            space: What it has to be for; None: whatever it states, for looking at a file of any robot.

        Raises:
            ApplrError: It is absent, damaged, too big, of other shapes, made for another robot or parameter space, or
                its checksum is wrong.
        """
        path = os.fspath(path)
        weights, metadata = _read(path)
        return cls._of(path, weights, metadata, space)

    @classmethod
    def _of(cls, path, weights, metadata, space):
        if "observation" in metadata:
            raise ApplrError(f"{path}: it is for every robot: read it with GeneralActor.load, or actor.load")
        space = _stated(path, metadata) if space is None else space.paper
        robot = metadata.get("robot")
        if robot != space.robot:
            raise ApplrError(f"{path}: it is for the robot {_short(robot)}: here {space.robot} runs; train one for it")
        described = json.loads(space.to_json())
        del described["theta0"]  # a robot's own parameter files may start elsewhere
        _compare(path, "parameter space", metadata.get("space"), described)
        try:
            layout = Layout.from_dict(_named(path, "layout", metadata.get("layout")), len(space))
            _layers(weights, space, layout, path)
            if metadata.get("with_mirror_images"):
                weights = with_mirror_images(weights, Mirror.of(layout.beams, 1 + len(space)))
            return cls(weights, space, metadata, layout)
        except (ValueError, ObservationError) as e:
            raise ApplrError(f"{path}: {e}") from None

    def action(self, obs):
        """The action (8,) or (n, 8) float32 in [-1, 1] for observations (729,) or (n, 729). NaN goes through."""
        return np.tanh(forward(self.layers, obs))

    def theta(self, obs):
        """The parameters (8,) for an observation (729,): scaled, counts rounded. Raises ApplrError on NaN or inf."""
        return self.space.to_theta(self.action(obs))


class GeneralActor:
    """A deterministic policy in the dimensionless form (encoding.py), for every robot: a network as Actor's.

    base: {name: value} of the parameters that it does not choose, as its metadata state them.
    """

    def __init__(self, weights, metadata=None):
        self.layers = layers_of(weights, encoding.SIZE, len(encoding.PARAMETERS), "actor")
        self.metadata = metadata or {}
        if "period_s" not in self.metadata:
            raise ApplrError("it states no period_s: what it sees depends on its decision period; train it again")
        self.period = period_of(self.metadata)
        self.base = self.metadata.get("base") or {}
        if not isinstance(self.base, dict) or not all(isinstance(v, (int, float)) for v in self.base.values()):
            raise ApplrError(f"its base is {_short(self.base)}: values of parameters by name are needed")

    @classmethod
    def load(cls, path):
        """Reads a file that save_general wrote. Raises ApplrError where it is none, or is damaged."""
        path = os.fspath(path)
        weights, metadata = _read(path)
        return cls._of(path, weights, metadata)

    @classmethod
    def _of(cls, path, weights, metadata):
        if metadata.get("observation") != encoding.NAME:
            raise ApplrError(
                f"{path}: its observation is {_short(metadata.get('observation'))}, {encoding.NAME} is needed"
            )
        try:
            layers_of(weights, encoding.SIZE, len(encoding.PARAMETERS), path)
            if metadata.get("with_mirror_images"):
                weights = with_mirror_images(weights, encoding.MIRROR)
            return cls(weights, metadata)
        except ValueError as e:
            raise ApplrError(f"{path}: {e}") from None

    def action(self, obs):
        """The action (12,) or (n, 12) float32 in [-1, 1] for observations of encoding.Encoding."""
        return np.tanh(forward(self.layers, obs))


def load(path, space=SPACE):
    """The policy in a file: a GeneralActor, or an Actor for `space`. Arguments and errors are those of Actor.load."""
    path = os.fspath(path)
    weights, metadata = _read(path)
    if "observation" in metadata:
        return GeneralActor._of(path, weights, metadata)
    return Actor._of(path, weights, metadata, space)


def save_general(path, weights, metadata=None):
    """Writes the file of a GeneralActor; arguments and errors as save's."""
    weights = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in weights.items()}
    GeneralActor(weights, metadata)
    _write(path, weights, metadata, {"observation": json.dumps(encoding.NAME)}, encoding.MIRROR)


def save(path, weights, metadata=None, space=SPACE, layout=LAYOUT):
    """Writes an actor file, whole or not at all (a temporary file beside it, then renamed).

    weights: as in Actor; metadata: {str: JSON value}, e.g. "training" and "result". Robot, space,
    layout and checksum are added. Of networks side by side of which every second one is the mirror image of the one
    before it, only the others are stored. Raises ApplrError.
    """
    weights = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in weights.items()}
    space = space.paper
    _layers(weights, space, layout, "actor to save")
    described = {"space": space.to_json(), "layout": json.dumps(layout.to_dict(len(space)))}
    described["robot"] = json.dumps(space.robot)
    _write(path, weights, metadata, described, Mirror.of(layout.beams, 1 + len(space)))


def _write(path, weights, metadata, described, mirror):
    header = {key: json.dumps(value) for key, value in (metadata or {}).items()}
    halves = {name: np.ascontiguousarray(value[::2]) for name, value in weights.items()}
    if weights["0.weight"].ndim == 3 and _alike(with_mirror_images(halves, mirror), weights):
        weights, header["with_mirror_images"] = halves, "true"
    _seal(path, weights, dict(header, **described))


def _seal(path, weights, header):
    header["format"] = FORMAT
    header["sha256"] = checksum(weights, header)
    files.write_bytes(path, safetensors.numpy.save(weights, metadata=header))


def renew(*paths):
    """Writes files of an earlier version anew, with the checksum of today. Raises ApplrError where one is none."""
    for path in paths:
        weights, header = unpack(files.read_bytes(path, MAX_BYTES), path)
        if header.get("format") != BEFORE or header.get("sha256") != checksum(weights, {}):
            raise ApplrError(f"{path}: no policy of an earlier version (format {BEFORE}), or a damaged one")
        _seal(path, weights, header)


def _alike(found, weights):
    same = (found[k].shape == t.shape and np.allclose(found[k], t, rtol=0.0, atol=1e-12) for k, t in weights.items())
    return all(same)


def _read(path):
    """(weights, metadata) of a safetensors file whose structure, sizes and checksum hold; else ApplrError."""
    data = files.read_bytes(path, MAX_BYTES)
    weights, header = unpack(data, path)
    if header.get("format") == BEFORE:
        raise ApplrError(
            f"{path}: an earlier version wrote it, with a checksum that leaves out what the file says of itself; "
            f"python -m applr_ros1.policy.actor {path} writes it anew"
        )
    if header.get("format") != FORMAT:
        raise ApplrError(
            f"{path}: no actor of ours (format {header.get('format')!r}, expected {FORMAT!r}); "
            "give a file that train.py wrote"
        )
    if header.get("sha256") != checksum(weights, header):
        raise ApplrError(f"{path}: its checksum is wrong; the file was damaged or changed, copy it again")
    return weights, {key: _value(text) for key, text in header.items()}


def _value(text):
    """A metadata entry: JSON where it is JSON, else the plain string (format, sha256)."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def _layers(weights, space, layout, name):
    return layers_of(weights, layout.beams + 1 + len(space), len(space), name)


def _named(path, what, found):
    """An entry of the metadata that is a JSON object; ApplrError where it is absent."""
    if not isinstance(found, dict):
        raise ApplrError(
            f"{path}: its metadata name no {what}; it was not written by this package, give a file that train.py wrote"
        )
    return found


def _stated(path, metadata):
    """The space that an actor's metadata state."""
    try:
        return Space.stated(_named(path, "parameter space", metadata.get("space")), metadata.get("robot"))
    except ApplrError as e:
        raise ApplrError(f"{path}: {e}; copy or train it again") from None


def _compare(path, what, found, expected):
    found = _named(path, what, found)
    for key, value in expected.items():
        if found.get(key) != value:
            raise ApplrError(
                f"{path}: made for another {what}: {key} is {_short(found.get(key))}, "
                f"here {_short(value)}; train one for this {what}"
            )


def _short(value):
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."


if __name__ == "__main__":
    sys.exit(run_main(lambda: renew(*sys.argv[1:]), "applr_ros1.policy.actor"))
