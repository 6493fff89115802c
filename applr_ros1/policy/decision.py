"""A decision: what it is made from, how often, and what a method is, which makes it: on the robot and in training."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Dict, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import LAYOUT, goal_angle, local_goal, observe, without_gaps
from applr_ros1.policy.parameter_space import SPACE, Space

PERIOD = 2.0  # s between two decisions in the paper; files that state no other period have this one


class Seen(NamedTuple):
    """What a decision is made from, before any layout and beside the parameters: msg/Decision.msg holds it.

    scan: ranges (n,) float32 [m] as measured, direction of the first and step to the next [rad] in the robot's frame.
    The others are as in a Context.
    """

    scan: Tuple[np.ndarray, float, float]
    time: float
    pose: Pose
    twist: Tuple[float, float]
    goal: Pose
    plan: np.ndarray
    movers: np.ndarray


@dataclass(frozen=True)
class Context:
    """The surroundings and state that a method may look at when it decides.

    Attributes:
        ranges: (720,) float32 [m], +inf where nothing returned. Scans of other lasers are resampled to this: see
            Layout in layout.py.
        phi: Angle to the local goal [rad].
        theta: (n,) float64, the parameters that the planner has now.
        time: Time since the goal was sent [s].
        pose: (x, y, yaw) [m, m, rad] of the robot as its odometry states it. Goal and plan are in the same frame.
        twist: (v, w) [m/s, rad/s] of the robot by its odometry.
        goal: (x, y, yaw) [m, m, rad] that was sent.
        plan: (n, >= 2) x, y [m] of the newest global plan, from robot to goal; (0, 2) before the first one.
        movers: (k, 4) x, y [m], vx, vy [m/s] of what is seen moving, in the same frame.
        space: The parameters that are in theta.
        layout: How ranges see the scan.
    """

    ranges: np.ndarray
    phi: float
    theta: np.ndarray
    time: float
    pose: Pose = (0.0, 0.0, 0.0)
    twist: Tuple[float, float] = (0.0, 0.0)
    goal: Pose = (0.0, 0.0, 0.0)
    plan: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    movers: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    space: Space = SPACE
    layout: Layout = LAYOUT

    @classmethod
    def of(cls, theta: np.ndarray, seen: Seen, space: Space, layout: Layout) -> Context:
        """Make it of what was seen, for a layout; without a plan the local goal is the goal.

        The applr node, the learning environment and the bag reader make it here. Raises ObservationError for a scan
        that the layout cannot take or in which nothing was measured, and for a plan or pose that is not finite.
        """
        scan, time, pose, twist, goal, plan, movers = seen
        ranges = layout.resample(*scan)
        without_gaps(ranges, layout)
        phi = goal_angle(local_goal(plan if len(plan) else [goal[:2]], pose, layout.lookahead))
        return cls(ranges, phi, theta, time, pose, twist, goal, plan, movers, space, layout)

    @cached_property
    def observation(self) -> np.ndarray:
        """(729,) float32 in [-1, 1]: scan capped at 2 m, angle to the local goal, parameters in force.

        Other numbers for other robots than the Jackal. Raises ObservationError as observation.observe does.
        """
        return observe(self.ranges, self.phi, self.theta, self.space, self.layout)


def period_of(metadata: Mapping[str, Any]) -> float:
    """Return the decision period [s] that a policy file's metadata state (`period_s`), else the paper's."""
    return float(metadata.get("period_s", PERIOD))


class Method:
    """A choice of the planner's parameters at each decision.

    Attributes:
        name: The specification that it was made from.
        static: Whether theta is the same whatever the context is. The node asks a static method once, with None, and
            what a person changes later stands.
        period: Time [s] between two decisions.
        space: The parameters that it chooses. `make` gives it the robot's where it states none.
        layout: How it sees a scan: what Context.ranges and Context.observation are made with. `make` gives it the
            robot's where it states none.
        per_cell: Whether the distance biases of its sets are meant for a planner that counts per cell, as those of all
            learned sets here: the applr node then rescales them for a planner that counts per metre
            (nodes/applr/meter_scoring.py). Otherwise they are sent as they are.
        stalls: Decisions so far that it made otherwise because the robot had stalled.
    """

    name = ""
    static = False
    period = PERIOD
    space: Space = SPACE
    layout: Layout = LAYOUT
    per_cell: bool = False
    stalls: int = 0

    def reset(self, seed: int) -> None:
        """Begin a course. Everything random is drawn from this seed only."""

    def theta(self, context: Optional[Context]) -> np.ndarray:
        """Return the parameters (n,) until the next decision. Raises ApplrError where there are none to be had."""
        raise NotImplementedError

    def describe(self) -> Dict[str, Any]:
        """Return what is recorded beside results: two methods that describe themselves alike drive alike."""
        return {"class": type(self).__name__}
