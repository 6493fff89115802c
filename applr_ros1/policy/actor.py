"""The policies that a file holds: Actor and ContextPolicy for one robot, GeneralActor for every robot.

A file is safetensors: a multilayer perceptron, and in the header what it states of itself as JSON. `load` tells the
kinds apart; the trainer writes with `save` and `save_general`, training/appld.py with `save_contexts`. Nothing is
unpickled, sizes are bounded, and every way in which a file can be wrong is one line.
"""

import json
import os

import numpy as np
import safetensors.numpy

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.tensors import checksum, unpack
from applr_ros1.policy import encoding
from applr_ros1.policy.decision import PERIOD, period_of
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.network import Mirror, forward, layers_of, with_mirror_images
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE, Space

FORMAT, CONTEXTS = "applr-actor-2", "applr-appld-1"
MAX_BYTES = 256 * 2**20  # a 3 x 512 actor has 3.6 MB
MAX_CONTEXTS = 64


class Actor:
    """A deterministic policy: ReLU layers and tanh at the end (the paper's has three hidden layers of 512).

    weights: {"0.weight": (512, 729), "0.bias": (512,), "1.weight": ..., last (8, 512)} float32. layout: the Layout of
    its observations; those have 729 numbers for the Jackal.
    """

    def __init__(self, weights, space=SPACE, metadata=None, layout=LAYOUT):
        self.space, self.layout, self.metadata = space.paper, layout, metadata or {}
        mirror = Mirror.of(layout.beams, 1 + len(self.space))
        self.layers = _layers(weights, self.metadata, layout.beams + 1 + len(self.space), len(self.space), mirror)
        self.period = period_of(self.metadata)

    @classmethod
    def _of(cls, weights, metadata, space):
        stated = _named(metadata, "space")
        space = (space or Space.stated(stated, metadata.get("robot"))).paper
        _check_robot(metadata, space)
        described = json.loads(space.to_json())
        del described["theta0"]  # a robot's own parameter files may start elsewhere
        for key, value in described.items():
            if stated.get(key) != value:
                raise ApplrError(
                    f"made for another parameter space: {key} is {_short(stated.get(key))}, here {_short(value)}; "
                    "train one for this parameter space"
                )
        return cls(weights, space, metadata, Layout.from_dict(_named(metadata, "layout"), len(space)))

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
        self.metadata = metadata or {}
        self.layers = _layers(weights, self.metadata, encoding.SIZE, len(encoding.PARAMETERS), encoding.MIRROR)
        if "period_s" not in self.metadata:
            raise ApplrError("it states no period_s: what it sees depends on its decision period; train it again")
        self.period = period_of(self.metadata)
        self.base = self.metadata.get("base") or {}
        if not isinstance(self.base, dict) or not all(isinstance(v, (int, float)) for v in self.base.values()):
            raise ApplrError(f"its base is {_short(self.base)}: values of parameters by name are needed")

    @classmethod
    def _of(cls, weights, metadata, _space):
        if metadata["observation"] != encoding.NAME:
            raise ApplrError(f"its observation is {_short(metadata['observation'])}, {encoding.NAME} is needed")
        return cls(weights, metadata)

    def action(self, obs):
        """The action (12,) or (n, 12) float32 in [-1, 1] for observations of encoding.Encoding."""
        return np.tanh(forward(self.layers, obs))


class ContextPolicy:
    """APPLD's policy: contexts with a parameter set each, and a classifier that tells the context from the scan.

    contexts  {name: theta (k,)} of `space`; values outside are clipped to it
    weights   {"0.weight": (h, 720), "0.bias": (h,), ..., last (k, h)} float32: ReLU layers on the scan as the
              observation has it (capped at 2 m, scaled to [-1, 1]); the largest output is the context
    layout    how it sees a scan; another one has another number of inputs
    """

    period = PERIOD  # the paper's

    def __init__(self, contexts, weights, space=SPACE, metadata=None, layout=LAYOUT):
        if not 1 <= len(contexts) <= MAX_CONTEXTS:
            raise ApplrError(f"{len(contexts)} contexts: give 1 to {MAX_CONTEXTS}")
        self.names, self.space, self.layout = list(contexts), space.paper, layout
        self.sets = np.array([self.space.complete(theta) for theta in contexts.values()])
        self.metadata = metadata or {}
        self.layers = layers_of(weights, layout.beams, len(self.names), "its network")

    @classmethod
    def _of(cls, weights, metadata, space):
        space = space.paper
        _check_robot(metadata, space)
        if metadata["names"] != list(space.names):
            raise ApplrError(f"its sets are of {_short(metadata['names'])}, not of {', '.join(space.names)}")
        contexts = {str(c["name"]): space.clip(c["theta"]) for c in metadata["contexts"]}
        return cls(contexts, weights, space, metadata, Layout.from_dict(_named(metadata, "layout"), 0))

    def context(self, obs):
        """The index of the context that an observation (729,), or its first 720 entries, shows."""
        return int(np.argmax(forward(self.layers, np.asarray(obs, dtype=np.float32)[: self.layout.beams])))

    def theta(self, obs):
        """The parameters (n,) float64 for an observation float32."""
        return self.sets[self.context(obs)].copy()


def load(path, space=SPACE, kinds=(Actor, GeneralActor)):
    """The policy in a file. How it sees a scan is its own: see the policy's `layout`.

    Args:
        path: The file.
        space: What an Actor or a ContextPolicy has to be for; None: whatever an Actor states, for looking at a file of
            any robot.
        kinds: The classes that it may be of.

    Raises:
        ApplrError: It is absent, damaged, too big, of other shapes, made for another robot or parameter space, of
            another kind, or its checksum is wrong.
    """
    path = os.fspath(path)
    weights, header = unpack(files.read_bytes(path, MAX_BYTES), path)
    form, stated = header.get("format"), header.get("sha256")
    if form not in (FORMAT, CONTEXTS):
        raise ApplrError(f"{path}: no policy of ours (format {form!r}); give a file that train.py or appld.py wrote")
    if stated != checksum(weights, header) and (stated or form == FORMAT):  # the first files of contexts had none
        raise ApplrError(f"{path}: its checksum is wrong; the file was damaged or changed, copy it again")
    metadata = {key: _value(text) for key, text in header.items()}
    kind = ContextPolicy if form == CONTEXTS else GeneralActor if "observation" in metadata else Actor
    if kind not in kinds:
        needed = " or ".join(wanted.__name__ for wanted in kinds)
        raise ApplrError(f"{path}: it holds a policy of the kind {kind.__name__}; one of {needed} is needed")
    try:
        return kind._of(weights, metadata, space)
    except (KeyError, TypeError) as error:
        raise ApplrError(f"{path}: its metadata are damaged ({error}); copy or make it again") from None
    except ValueError as error:
        raise ApplrError(f"{path}: {error}") from None


def save(path, weights, metadata=None, space=SPACE, layout=LAYOUT):
    """Writes an Actor's file, whole or not at all (a temporary file beside it, then renamed).

    weights: as in Actor; metadata: {str: JSON value}, e.g. "training" and "result". Robot, space,
    layout and checksum are added. Of networks side by side of which every second one is the mirror image of the one
    before it, only the others are stored. Raises ApplrError.
    """
    weights, space = _float32(weights), space.paper
    Actor(weights, space, layout=layout)
    described = {"robot": space.robot, "space": json.loads(space.to_json()), "layout": layout.to_dict(len(space))}
    _write(path, weights, FORMAT, {**(metadata or {}), **described}, Mirror.of(layout.beams, 1 + len(space)))


def save_general(path, weights, metadata=None):
    """Writes the file of a GeneralActor; arguments and errors as save's."""
    weights = _float32(weights)
    GeneralActor(weights, metadata)
    _write(path, weights, FORMAT, {**(metadata or {}), "observation": encoding.NAME}, encoding.MIRROR)


def save_contexts(path, contexts, weights, metadata=None, space=SPACE, layout=LAYOUT):
    """Writes the file of a ContextPolicy; contexts as there, the other arguments and errors as save's."""
    weights, space = _float32(weights), space.paper
    ContextPolicy(contexts, weights, space, layout=layout)
    entries = [{"name": name, "theta": [float(v) for v in theta]} for name, theta in contexts.items()]
    described = {"contexts": entries, "robot": space.robot, "names": space.names, "layout": layout.to_dict(0)}
    _write(path, weights, CONTEXTS, {**(metadata or {}), **described})


def _write(path, weights, form, metadata, mirror=None):
    header = {key: json.dumps(value) for key, value in metadata.items()}
    if mirror is not None and weights["0.weight"].ndim == 3:
        halves = {name: np.ascontiguousarray(value[::2]) for name, value in weights.items()}
        if _alike(with_mirror_images(halves, mirror), weights):
            weights, header["with_mirror_images"] = halves, "true"
    header["format"] = form
    header["sha256"] = checksum(weights, header)
    files.write_bytes(path, safetensors.numpy.save(weights, metadata=header))


def _layers(weights, metadata, inputs, outputs, mirror):
    """The checked layers of an actor's network, with its mirror images where a file leaves them out."""
    layers = layers_of(weights, inputs, outputs, "its network")
    if not metadata.get("with_mirror_images"):
        return layers
    return layers_of(with_mirror_images(weights, mirror), inputs, outputs, "its network")


def _alike(found, weights):
    same = (found[k].shape == t.shape and np.allclose(found[k], t, rtol=0.0, atol=1e-12) for k, t in weights.items())
    return all(same)


def _float32(weights):
    return {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in weights.items()}


def _value(text):
    """A metadata entry: JSON where it is JSON, else the plain string (format, sha256)."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def _named(metadata, what):
    """An entry of the metadata that is a JSON object; ApplrError where it is absent."""
    if not isinstance(metadata.get(what), dict):
        raise ApplrError(f"its metadata name no {what}; it was not written by this package, give a file that it wrote")
    return metadata[what]


def _check_robot(metadata, space):
    if metadata.get("robot") != space.robot:
        raise ApplrError(
            f"it is for the robot {_short(metadata.get('robot'))}: here {space.robot} runs; make one for it"
        )


def _short(value):
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
