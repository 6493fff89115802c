"""A network of another project as a method: its own inputs, outputs, ranges and period, stated in a few lines."""

from __future__ import annotations

import os
from typing import Any, Callable, ClassVar, Dict, Mapping, Optional, Tuple

import numpy as np

from applr_ros1 import robots
from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.common.files import read_bytes, sha256
from applr_ros1.common.tensors import unpack
from applr_ros1.policy.decision import PERIOD, Context
from applr_ros1.policy.methods.protocol import Method
from applr_ros1.policy.network import forward, layers_of
from applr_ros1.policy.parameter_space import space_of

MAX_BYTES = 256 * 2**20


class ForeignActor(Method):
    """A multilayer perceptron (ReLU between its layers) that chooses parameters; derive a class that states how.

        class Theirs(ForeignActor):                  # evaluate.py --methods dwa,my_file.py:Theirs:actor.safetensors
            size = 721                               # number of inputs
            period = 1.0                             # s between two decisions
            ranges = {"max_vel_x": (0.2, 2.0), "vx_samples": (4, 12)}    # the outputs in their order

            def inputs(self, context):               # (721,) from what Context holds
                return np.append(np.clip(context.ranges, 0.0, 2.0), context.phi)

    Outputs -1 and 1 mean the low and the high end of a range; counts are rounded. Parameters that are not among the
    outputs keep theta_0, and values beyond the bounds of the parameter space are clipped to them.

    Attributes:
        robot: Name or folder of the robot that it is for.
        size: Number of inputs.
        ranges: {name: (low, high)} of the parameters that the outputs stand for, in the outputs' order.
        activation: What the last layer's output goes through.

    Args:
        path: A safetensors file with 0.weight (h, size), 0.bias (h,), 1.weight, ... in float32
            (docs/tutorials/own_method.md makes one of a PyTorch file).

    Raises:
        ApplrError: The file cannot be used, or the class states something that cannot be.
    """

    robot: ClassVar[str] = "jackal"
    size: ClassVar[int] = 0
    period = PERIOD
    ranges: ClassVar[Mapping[str, Tuple[float, float]]] = {}
    activation: ClassVar[Callable[[np.ndarray], np.ndarray]] = np.tanh

    def __init__(self, path: str = ""):
        name = type(self).__name__
        self.space = space_of(robots.load(self.robot))
        known = self.space.names
        unknown = [parameter for parameter in self.ranges if parameter not in known]
        if unknown or not self.ranges:
            raise ApplrError(
                "%s: ranges name %s; give some of %s" % (name, ", ".join(unknown) or "nothing", ", ".join(known))
            )
        if not path:
            raise ApplrError(
                "%s needs the file of its network: name it behind a colon, my_file.py:%s:FILE" % (name, name)
            )
        data = read_bytes(path, MAX_BYTES)
        weights, _ = unpack(data, path)
        self.layers = layers_of(weights, self.size, len(self.ranges), path)
        self.file, self.sha256 = os.path.basename(path), sha256(data)
        self._low, self._high = np.array(list(self.ranges.values()), dtype=np.float64).T
        self._places = [self.space.names.index(parameter) for parameter in self.ranges]

    def inputs(self, context: Context) -> Any:
        """The network's inputs (size,); for the derived class to say."""
        raise NotImplementedError

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """The parameters (n,) that the network chooses. Raises ApplrError where its inputs or outputs are unusable."""
        name = type(self).__name__
        if context is None:
            raise ApplrError("%s needs a scan to decide on" % name)
        try:
            given = np.asarray(self.inputs(context), dtype=np.float32)
        except Exception as error:
            raise ApplrError("%s: inputs(context) raised %s" % (name, one_line(error))) from error
        if given.shape != (self.size,):
            raise ApplrError("%s: inputs(context) gave shape %s, not (%d,)" % (name, given.shape, self.size))
        output = type(self).activation(forward(self.layers, given)).astype(np.float64)
        if not np.isfinite(output).all():
            raise ApplrError("%s: the network's output is not finite; check its inputs" % name)
        theta = self.space.theta0.copy()
        theta[self._places] = self._low + 0.5 * (output + 1.0) * (self._high - self._low)
        return self.space.clip(theta)

    def describe(self) -> Dict[str, Any]:
        """The class, its file with checksum, and the ranges."""
        ranges = {name: list(span) for name, span in self.ranges.items()}
        return {"class": type(self).__name__, "file": self.file, "sha256": self.sha256, "ranges": ranges}
