"""The encoding in which a policy sees a robot and sets its parameters: `Encoding`, and the paper's.

The other one is in dimensionless.py. The learning environment, the files of policies (actor.py) and the bag reader ask
an encoding, and never which one it is.
"""

from __future__ import annotations

from typing import Any, ClassVar, Dict, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import PERIOD, Context, period_of
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot

PAPER = "paper"


class Mirror(NamedTuple):
    """The change of an observation x where left and right are exchanged: it becomes x[order] * sign.

    order: (n,) int; sign: (n,) float32, 1 or -1.
    """

    order: np.ndarray
    sign: np.ndarray

    @classmethod
    def of(cls, beams: int, rest: int, scans: int = 1, mirror_sign: Tuple[int, ...] = (0,)) -> Mirror:
        """Make it for `scans` scans, `beams` numbers together, and `rest` more; those at `mirror_sign` change sign."""
        order, sign = np.arange(beams + rest), np.ones(beams + rest, np.float32)
        order[:beams] = order[:beams].reshape(scans, -1)[:, ::-1].ravel()
        sign[[beams + i for i in mirror_sign]] = -1.0
        return cls(order, sign)


def with_mirror_images(weights: Mapping[str, np.ndarray], mirror: Mirror) -> Dict[str, np.ndarray]:
    """Return networks side by side, each followed by the one that answers as it does with left and right exchanged.

    Args:
        weights: One network, or several side by side.
        mirror: What exchanging left and right does to their input.
    """
    several = {name: t if weights["0.weight"].ndim == 3 else t[None] for name, t in weights.items()}
    images = dict(several, **{"0.weight": (several["0.weight"] * mirror.sign)[..., mirror.order]})
    return {name: np.stack([t, images[name]], axis=1).reshape(-1, *t.shape[1:]) for name, t in several.items()}


class Encoding:
    """Observations and actions of one robot.

    Args:
        robot: Its description.
        period: Decision period [s]; None is the paper's.
        base: {name: value} that parameters have which an action does not choose, clipped to their ranges; those that it
            does not name have their default values.

    Attributes:
        name: What options and files call the encoding.
        redraws_stalled: Whether a policy's parameters are drawn at random while the robot stalls.
        space: The robot's parameter space.
        layout: How Context.ranges has to see the scan.
        chosen: Names of the space's parameters that an action chooses.
        size, actions: How many numbers an observation and an action have, all in [-1, 1].
        scan: How many numbers of an observation, the first ones, are of scans; scans: of how many.
        mirror_sign: Indices behind the scans of the numbers that change their sign with left and right exchanged.
        scale: How many of the Jackal's widths the robot is wide, by which the reward's lengths are divided.
        pace: How many times as long as the Jackal it takes for a course of its scale at its base's top speed, by which
            the reward's times are divided.
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
    scale = pace = 1.0

    def __init__(self, robot: Robot, period: Optional[float], base: Optional[Mapping[str, float]] = None):
        self.robot, self.space, self.base = robot, space_of(robot), dict(base or {})
        self.period = PERIOD if period is None else period

    @property
    def mirror(self) -> Mirror:
        """The change of an observation where left and right are exchanged."""
        return Mirror.of(self.scan, self.size - self.scan, self.scans, self.mirror_sign)

    def to_metadata(self) -> Dict[str, Any]:
        """Return what a policy's file states of the encoding, JSON values; `of` makes the encoding of it."""
        raise NotImplementedError

    @classmethod
    def of(cls, stated: Mapping[str, Any], robot: Robot) -> Encoding:
        """Make the encoding that a policy's file states, for a robot. Raises ApplrError if it is for another robot."""
        raise NotImplementedError

    def reset(self) -> None:
        """Begin a course: there is no decision before."""

    def observe(self, context: Context) -> np.ndarray:
        """Return the observation (size,) float32 of a decision. Raises ObservationError as observation.observe does."""
        raise NotImplementedError

    def theta(self, action: Any) -> np.ndarray:
        """Return the parameters (n,) of the robot's space for an action (actions,), within the robot's ranges.

        Raises ApplrError for NaN, infinity and another length.
        """
        raise NotImplementedError

    def action(self, theta: Any) -> np.ndarray:
        """Return the action (actions,) in [-1, 1] that stands for parameters (n,) of the robot's space."""
        raise NotImplementedError


class PaperEncoding(Encoding):
    """The paper's encoding: capped scan, angle of the local goal, parameters; an action is these parameters, scaled.

    Args:
        robot, period, base: As of an Encoding; the last two have no effect.
        layout: How it sees a scan; None: as the robot's laser looks.
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
        self.layout, self.chosen = layout or layout_of(robot), self.space.chosen.names
        self.scan, self.actions = self.layout.beams, len(self.chosen)
        self.size = self.scan + 1 + self.actions

    def to_metadata(self) -> Dict[str, Any]:
        """Return robot, space and layout; a policy's file may state the period beside them."""
        space = self.space.chosen
        return {"robot": space.robot, "space": space.to_dict(), "layout": self.layout.to_dict()}

    @classmethod
    def of(cls, stated: Mapping[str, Any], robot: Robot) -> PaperEncoding:
        """Make the encoding of a file for this very robot, whose parameter files may start elsewhere (theta0)."""
        space = space_of(robot).chosen
        check_robot(stated, robot)
        for key, value in space.to_dict().items():
            has = stated["space"].get(key)
            if key != "theta0" and has != value:
                raise ApplrError(f"made for another parameter space: {key} is {has}, here {value}; train one for this")
        return cls(robot, period_of(stated), layout=Layout.from_dict(stated["layout"]))

    def observe(self, context: Context) -> np.ndarray:
        """Return the observation that a Context holds."""
        return context.observation

    def theta(self, action: Any) -> np.ndarray:
        """Return the chosen parameters scaled to their ranges, counts rounded; the others have their default values."""
        return self.space.fill(self.space.chosen.to_theta(action))

    def action(self, theta: Any) -> np.ndarray:
        """Return the action; values beyond the ranges, which a person may set, are clipped."""
        return self.space.chosen.to_action(self.space.pick(theta))


def check_robot(stated: Mapping[str, Any], robot: Robot) -> None:
    """Raise ApplrError where a policy's file states another robot."""
    if stated.get("robot") != robot.name:
        raise ApplrError(f"it is for the robot {stated.get('robot')}: here {robot.name} runs; make one for it")
