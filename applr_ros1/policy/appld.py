"""APPLD's runtime half: a parameter set for each context, and a network that tells the context from the scan.

Called by policy/methods/registry.py; training/appld.py writes the file.
"""

import json
import os

import numpy as np
import safetensors.numpy

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.tensors import unpack
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.network import forward, layers_of
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import SPACE

FORMAT = "applr-appld-1"
MAX_BYTES = 64 * 2**20
MAX_CONTEXTS = 64


class Appld:
    """Contexts with their parameter sets, and a classifier.

    contexts  {name: theta (k,)} of `space`; values outside are clipped to it
    weights   {"0.weight": (h, 720), "0.bias": (h,), ..., last (k, h)} float32: ReLU layers on the scan as the
              observation has it (capped at 2 m, scaled to [-1, 1]); the largest output is the context
    layout    how it sees a scan; another one has another number of inputs
    """

    period = PERIOD  # the paper's

    def __init__(self, contexts, weights, space=SPACE, metadata=None, layout=LAYOUT):
        self.names, self.space, self.layout = list(contexts), space.paper, layout
        self.sets = np.array([self.space.complete(theta) for theta in contexts.values()])
        self.layers = _layers(weights, len(self.names), layout)
        self.metadata = metadata or {}

    @classmethod
    def load(cls, path, space=SPACE):
        """Reads a file that `save` wrote. Raises ApplrError; for one of another robot, too."""
        path, space = os.fspath(path), space.paper
        data = files.read_bytes(path, MAX_BYTES)
        weights, header = unpack(data, path)
        if header.get("format") != FORMAT:
            raise ApplrError(f"{path}: no APPLD file (format {header.get('format')!r}, expected {FORMAT!r})")
        robot = str(header.get("robot"))
        if robot != space.robot:
            raise ApplrError(f"{path}: it is for the robot {robot[:60]}: here {space.robot} runs; learn one for it")
        try:
            names = json.loads(header["names"]) if "names" in header else list(SPACE.paper.names)
            if names != list(space.names):
                raise ApplrError(f"its sets are of {', '.join(map(str, names))[:200]}")
            layout = Layout.from_dict(json.loads(header["layout"]), 0) if "layout" in header else LAYOUT
            contexts = {str(c["name"]): space.clip(c["theta"]) for c in json.loads(header["contexts"])}
            return cls(contexts, weights, space, {k: v for k, v in header.items() if k != "contexts"}, layout)
        except (KeyError, TypeError, ValueError) as error:
            raise ApplrError(f"{path}: its contexts or layers do not fit ({error})") from None

    def context(self, obs):
        """The index of the context that an observation (729,), or its first 720 entries, shows."""
        return int(np.argmax(forward(self.layers, np.asarray(obs, dtype=np.float32)[: self.layout.beams])))

    def theta(self, obs):
        """The parameters (n,) float64 for an observation float32."""
        return self.sets[self.context(obs)].copy()


def save(path, contexts, weights, metadata=None, space=SPACE, layout=LAYOUT):
    """Writes an APPLD file, whole or not at all. contexts: {name: theta (k,)}; metadata: {str: str}, its origin."""
    _layers(weights, len(contexts), layout)
    space = space.paper
    entries = [{"name": name, "theta": [float(v) for v in theta]} for name, theta in contexts.items()]
    header = dict(metadata or {}, format=FORMAT, contexts=json.dumps(entries), robot=space.robot)
    header.update(names=json.dumps(space.names), layout=json.dumps(layout.to_dict(0)))
    tensors = {k: np.ascontiguousarray(v, dtype=np.float32) for k, v in weights.items()}
    files.write_bytes(path, safetensors.numpy.save(tensors, metadata=header))


def _layers(weights, outputs, layout):
    if not 1 <= outputs <= MAX_CONTEXTS:
        raise ApplrError(f"{outputs} contexts: give 1 to {MAX_CONTEXTS}")
    return layers_of(weights, layout.beams, outputs, "APPLD's network")
