"""Interface of a method: the class Method, and the Context that it gets for each decision."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Dict, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.policy.layout import Layout
from applr_ros1.policy.observation import LAYOUT, goal_angle, local_goal, observe, without_gaps
from applr_ros1.policy.parameter_space import SPACE, Space

Metadata = Mapping[str, Any]  # metadata of a policy's file: JSON values by name
PERIOD = 2.0  # decision period of the paper, and default of policy files [s]


class Seen(NamedTuple):
    """Raw inputs of a decision, except the parameters, as msg/Decision.msg records them.

    scan has the measured ranges (n,) float32 [m], the direction of the first beam in the robot's
    frame [rad], and the angle between two beams [rad]. The other fields are as in a Context.
    """

    scan: Tuple[Array32, float, float]
    time: float
    pose: Pose
    twist: Twist
    goal: Pose
    plan: Array
    movers: Array


@dataclass(frozen=True)
class Context:
    """Inputs of a method's decision: surroundings and state of the robot.

    Attributes:
        ranges: (720,) float32 scan [m]; +inf for no return. Scans of other lasers are resampled
            (Layout in layout.py).
        phi: Angle to the local goal [rad].
        theta: (n,) float64, current parameters of the planner.
        time: Time since the goal was sent [s].
        pose: (x, y, yaw) [m, m, rad] of the robot in the frame of goal and plan.
        twist: (v, w) [m/s, rad/s] of the robot by its odometry.
        goal: (x, y, yaw) [m, m, rad] of the goal.
        plan: (n, >= 2) x, y [m] of the latest global plan, from robot to goal; (0, 2) before the
            first one.
        movers: (k, 4) x, y [m], vx, vy [m/s] of the tracked moving obstacles, in the same frame.
        space: Parameter space of theta.
        layout: Layout of ranges.
    """

    ranges: Array32
    phi: float
    theta: Array
    time: float
    pose: Pose = (0.0, 0.0, 0.0)
    twist: Twist = (0.0, 0.0)
    goal: Pose = (0.0, 0.0, 0.0)
    plan: Array = field(default_factory=lambda: np.zeros((0, 2)))
    movers: Array = field(default_factory=lambda: np.zeros((0, 4)))
    space: Space = SPACE
    layout: Layout = LAYOUT

    @classmethod
    def of(cls, theta: Array, seen: Seen, space: Space, layout: Layout) -> Context:
        """Make the context from raw inputs, for a layout.

        Without a plan, the goal is used as the local goal.

        The applr node, the learning environment and the bag reader all use this constructor.

        Raises:
            ObservationError: The scan does not fit the layout or has no valid beam, or plan or pose
                is not finite.
        """
        ranges = layout.resample(*seen.scan)
        # A blind scan is refused here, before a method or a file gets the context.
        without_gaps(ranges, layout)
        # The first decision may come before the planner's first plan.
        plan_points = seen.plan if len(seen.plan) else [seen.goal[:2]]
        phi = goal_angle(local_goal(plan_points, seen.pose, layout.lookahead))
        return cls(
            ranges=ranges,
            phi=phi,
            theta=theta,
            time=seen.time,
            pose=seen.pose,
            twist=seen.twist,
            goal=seen.goal,
            plan=seen.plan,
            movers=seen.movers,
            space=space,
            layout=layout,
        )

    @cached_property
    def observation(self) -> Array32:
        """Observation (729,) float32 in [-1, 1]: capped scan, goal angle, current parameters.

        Sizes and cap differ for robots other than the Jackal. Raises ObservationError as
        observation.observe does.
        """
        return observe(self.ranges, self.phi, self.theta, self.space, self.layout)


def period_of(metadata: Metadata) -> float:
    """Return the decision period [s] in a policy file's metadata, or the paper's."""
    return float(metadata.get("period_s", PERIOD))


class Method:
    """Base class of methods that choose the planner's parameters at each decision.

    Path and goal distance biases are per costmap cell, in the context and in the choice. The applr
    node converts them for a planner that counts per metre (nodes/applr/meter_scoring.py).

    Attributes:
        name: Specification from which the method was made (methods.make).
        static: Whether theta does not depend on the context. The node asks a static method once,
            with None, so that later changes by a user persist.
        period: Decision period [s].
        space: Space of the parameters that theta() returns. `make` sets the robot's space if the
            class has none.
        layout: Layout of Context.ranges and Context.observation. `make` sets the robot's layout if
            the class has none.
        redraws_stalled: Whether parameters are drawn at random while the robot has stalled
            (policy/stall_rule.py).
        obstacle_range: Range [m] up to which lasers must mark obstacles in the costmaps, because
            the method was made for it. move_base reads it once, at its start. None for the range
            in the robot's files.
    """

    name = ""
    static = False
    period = PERIOD
    space: Space = SPACE
    layout: Layout = LAYOUT
    redraws_stalled: bool = True
    obstacle_range: Optional[float] = None

    def reset(self, seed: int) -> None:
        """Prepare for a new course, and seed all random draws."""

    def theta(self, context: Optional[Context]) -> Array:
        """Return the parameters (n,) to use until the next decision.

        Raise ApplrError if the method cannot decide.
        """
        raise NotImplementedError

    def describe(self) -> Dict[str, Any]:
        """Return a description to record with results.

        Methods with equal descriptions behave the same.
        """
        return {"class": type(self).__name__}
