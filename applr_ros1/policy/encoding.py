"""Encodings of a policy's observations and actions: base class, and the paper's encoding.

The dimensionless encoding is in dimensionless.py. The learning environment, the policy files
(actor.py) and the bag reader only depend on the base class.
"""

from __future__ import annotations

from typing import Any, ClassVar, Dict, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.arrays import Array, Array32, Data
from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import PERIOD, Context, Metadata, period_of
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot

PAPER = "paper"


class Mirror(NamedTuple):
    """Left-right reflection of an observation x, which becomes x[order] * sign.

    order: (n,) int; sign: (n,) float32, 1 or -1.
    """

    order: Data
    sign: Data

    @classmethod
    def of(
        cls, beams: int, rest: int, scans: int = 1, mirror_sign: Tuple[int, ...] = (0,)
    ) -> Mirror:
        """Make the reflection of an observation that consists of scans, followed by other entries.

        Args:
            beams: Number of entries of all scans together.
            rest: Number of entries after the scans.
            scans: Number of scans.
            mirror_sign: Indices, counted after the scans, of the entries that change sign.
        """
        # Each scan is reversed for itself.
        order = np.arange(beams + rest)
        scan_order = order[:beams].reshape(scans, -1)
        order[:beams] = scan_order[:, ::-1].ravel()
        sign = np.ones(beams + rest, np.float32)
        sign[beams + np.asarray(mirror_sign, dtype=np.int64)] = -1.0
        return cls(order, sign)


def with_mirror_images(weights: Mapping[str, Array32], mirror: Mirror) -> Dict[str, Array32]:
    """Return an ensemble with each network and its mirror image.

    The mirror image is the same network on the mirrored observation.

    Args:
        weights: Tensors of one network, such as 0.weight (outputs, inputs), or of an ensemble,
            whose first axis counts the networks.
        mirror: Reflection of the networks' input.
    """
    is_ensemble = weights["0.weight"].ndim == 3
    ensemble = {}
    for tensor_name, networks in weights.items():
        if not is_ensemble:
            networks = networks[None]
        mirror_images = networks
        if tensor_name == "0.weight":  # Only the first layer takes the observation.
            # The order is its own inverse: it swaps pairs of inputs.
            mirror_images = (networks * mirror.sign)[..., mirror.order]
        # Each network is followed by its image; policy files leave out every second one.
        network_pairs = np.stack([networks, mirror_images], axis=1)
        ensemble[tensor_name] = network_pairs.reshape(-1, *networks.shape[1:])
    return ensemble


class Encoding:
    """Encoding of observations and actions for one robot.

    Args:
        robot: Description of the robot.
        period: Decision period [s]; None for the paper's.
        base: {name: value} of parameters that an action does not choose, clipped to their ranges.
            Parameters that are missing here have their default values.

    Attributes:
        name: Name of the encoding in options and files.
        redraws_stalled: Whether parameters are drawn at random while the robot has stalled.
        space: Parameter space of the robot.
        layout: Layout of Context.ranges.
        chosen: Names of the parameters that an action chooses.
        size: Number of entries of an observation, all in [-1, 1].
        actions: Number of entries of an action, all in [-1, 1].
        scan: Number of entries of all scans, which come first in an observation.
        scans: Number of scans in an observation.
        mirror_sign: Indices, counted after the scans, of the entries that change sign in the mirror
            image.
        scale: Width of the robot relative to the Jackal's, by which lengths in the reward are
            divided.
        pace: Time for a course of the robot's scale at maximum speed, relative to the Jackal's, by
            which times in the reward are divided.
    """

    name: ClassVar[str]
    redraws_stalled: ClassVar[bool] = False
    layout: Layout
    chosen: Tuple[str, ...]
    size: int
    actions: int
    scan: int
    scans = 1
    mirror_sign: Tuple[int, ...] = (0,)
    scale = 1.0
    pace = 1.0

    def __init__(
        self, robot: Robot, period: Optional[float], base: Optional[Mapping[str, float]] = None
    ):
        self.robot = robot
        self.space = space_of(robot)
        self.base = dict(base or {})
        self.period = PERIOD
        if period is not None:
            self.period = period

    @property
    def mirror(self) -> Mirror:
        """Left-right reflection of an observation."""
        return Mirror.of(self.scan, self.size - self.scan, self.scans, self.mirror_sign)

    def to_metadata(self) -> Metadata:
        """Return the metadata of the encoding for a policy's file, as JSON values.

        The inverse is `of`.
        """
        raise NotImplementedError

    @classmethod
    def of(cls, metadata: Metadata, robot: Robot) -> Encoding:
        """Make the encoding from a policy's metadata, for a robot.

        Raises ApplrError if they are for another robot.
        """
        raise NotImplementedError

    def forget_decision(self) -> None:
        """Forget the previous decision at the start of a course."""

    def observe(self, context: Context) -> Array32:
        """Return the observation (size,) float32 of a decision.

        Raises ObservationError as observation.observe does.
        """
        raise NotImplementedError

    def theta(self, action: Any) -> Array:
        """Return the parameters (n,) for an action (actions,), which the Pilot clips.

        Raises ApplrError for NaN, infinity and another length.
        """
        raise NotImplementedError

    def action(self, theta: Any) -> Array:
        """Return the action (actions,) in [-1, 1] that encodes parameters (n,)."""
        raise NotImplementedError


class PaperEncoding(Encoding):
    """The paper's encoding.

    An observation is scan, local goal angle and parameters. An action is scaled parameters.

    Args:
        robot, period, base: As for an Encoding; period and base do not change this encoding.
        layout: Layout of the scan; None for the default layout of the robot's laser.
    """

    name = PAPER

    def __init__(
        self,
        robot: Robot,
        period: Optional[float] = None,
        base: Optional[Mapping[str, float]] = None,
        layout: Optional[Layout] = None,
    ):
        super().__init__(robot, period)
        self.layout = layout or layout_of(robot)
        self.chosen = self.space.chosen.names
        self.scan = self.layout.beams
        self.actions = len(self.chosen)
        self.size = self.scan + 1 + self.actions

    def to_metadata(self) -> Metadata:
        """Return robot, space and layout. The period may be added to a policy's file separately."""
        space = self.space.chosen
        return {"robot": space.robot, "space": space.to_dict(), "layout": self.layout.to_dict()}

    @classmethod
    def of(cls, metadata: Metadata, robot: Robot) -> PaperEncoding:
        """Make the encoding from a policy's metadata, for the same robot.

        Only the default parameters may differ.
        """
        # Actions are shares of the ranges: other ranges would give other parameters.
        space = space_of(robot).chosen
        check_robot(metadata, robot)
        for entry_name, needed_value in space.to_dict().items():
            stored_value = metadata["space"].get(entry_name)
            if entry_name != "theta0" and stored_value != needed_value:
                difference = f"{entry_name} is {stored_value}, here {needed_value}"
                raise ApplrError(
                    f"made for another parameter space: {difference}; train one for this"
                )
        return cls(robot, period_of(metadata), layout=Layout.from_dict(metadata["layout"]))

    def observe(self, context: Context) -> Array32:
        """Return the observation of a Context."""
        return context.observation

    def theta(self, action: Any) -> Array:
        """Return the parameters (n,): space.chosen from the action, the others by default."""
        return self.space.fill(self.space.chosen.to_theta(action))

    def action(self, theta: Any) -> Array:
        """Return the action for parameters (n,).

        Values beyond the ranges, which a user may set, are clipped.
        """
        return self.space.chosen.to_action(self.space.chosen_of(theta))


def check_robot(metadata: Metadata, robot: Robot) -> None:
    """Raise ApplrError if a policy's metadata are for another robot."""
    if metadata.get("robot") != robot.name:
        raise ApplrError(f"made for the robot {metadata.get('robot')}: this robot is {robot.name}")
