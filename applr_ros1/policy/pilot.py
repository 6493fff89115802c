"""The Pilot makes every decision: it asks those who may decide, in order of their priority.

A person who sets values by hand comes first, then the stall rule, then the method. The applr node
and simulated trials ask a Pilot once per decision period; in the learning environment, the
learner's action is the decision. Anyone else who is to decide belongs into `decide`, beside the
stall rule. A period without a decision, such as one in which the method raised an error, is
reported with `miss`.

The Pilot alone clips parameters, and it owns the speed limit of all that are chosen. Others may set
parameters beside it: the last guard is at the base, where the move_base node slows each command
beyond the limit (nodes/move_base/node.py).
"""

from __future__ import annotations

import math
from typing import Mapping, NamedTuple, Optional

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.policy.decision import Context, Method, Seen
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.policy.stall_rule import StallRule
from applr_ros1.robots import Robot

# Number of successive periods without a decision after which the method counts as lost
LOST_PERIODS = 3
# Reasons of a choice
METHOD = "method"  # parameters of the method
STALL = "stall"  # parameters of the stall rule in place of those of the method
DEFAULTS = "defaults"  # default parameters of the robot, theta_0
BY_HAND = "set by hand"  # parameters that a person has set while the method is off


class Choice(NamedTuple):
    """Parameters to drive with from now on.

    Attributes:
        theta: Parameters (n,) within the ranges and the speed limit.
        clears_costmaps: Whether both costmaps are to be cleared before they take effect.
        why: METHOD, STALL, DEFAULTS or BY_HAND. The distance biases of method and stall rule are
            per costmap cell, those of the defaults are in the planner's own unit, and those set by
            hand in the unit of the parameters before.
    """

    theta: Array
    clears_costmaps: bool
    why: str


class Pilot:
    """Method, stall rule, fallback and speed limit of one robot.

    Args:
        method: Method that chooses the parameters; may be replaced between two decisions.
        robot: Description of the robot.
        period: Decision period [s]; None for the method's period.
        max_speed: Upper limit of the top speed [m/s], for every method and for the defaults.

    Attributes:
        space: Parameter space of the robot, below the speed limit.
        misses: Number of successive periods without a decision.
        stall_rule: Stall rule.
        by_hand: Choice of a person, which drives while the method is off; None without one.
    """

    def __init__(
        self,
        method: Method,
        robot: Robot,
        period: Optional[float] = None,
        max_speed: float = math.inf,
    ):
        self.method = method
        self.max_speed = max_speed
        self.space = space_of(robot)
        self._full_space = self.space
        if max_speed < math.inf:
            self.space = self.space.below(max_speed)
        self.misses = 0
        self.by_hand: Optional[Choice] = None
        self._period = period
        self.stall_rule = StallRule(robot)

    @property
    def period(self) -> float:
        """Decision period [s]: the period set for the pilot if any, else the method's."""
        if self._period is not None:
            return self._period
        return self.method.period

    @property
    def has_lost_method(self) -> bool:
        """True once LOST_PERIODS have passed without a decision."""
        return self.misses >= LOST_PERIODS

    def begin(self, seed: int) -> None:
        """Begin a course, and seed all random draws.

        Raises what the method raises, which may be user code. The course has begun nevertheless.
        """
        self.misses = 0
        self.stall_rule.begin_course(seed)
        self.method.period = self.period  # The observation may depend on the period.
        self.method.reset(seed)

    def set_by_hand(self, values: Mapping[str, float], theta: Optional[Array]) -> Choice:
        """Return a person's choice with {name: value}, clipped to the ranges, and keep it.

        Other parameters stay as they are.

        Args:
            values: {name: value}.
            theta: Parameters (n,) in force, or None if they are not known yet.

        Raises:
            ApplrError: A name is unknown, a value is not finite, or the parameters in force are not
                known. Nothing was changed.
        """
        # Two changes may follow each other faster than the servers answer.
        if self.by_hand is not None:
            theta = self.by_hand.theta
        if theta is None:
            raise ApplrError("the planner's parameters are not known yet")
        unknown_names = sorted(set(values) - set(self.space.names))
        if unknown_names:
            advice = f"use {', '.join(self.space.names)}"
            raise ApplrError(f"unknown parameter {shown(unknown_names[0])}: {advice}")
        changed = {**self.space.as_dict(theta), **values}
        self.by_hand = Choice(self.space.clip(list(changed.values())), False, BY_HAND)
        return self.by_hand

    def observe(self, theta: Array, seen: Seen) -> Context:
        """Return the context of a decision.

        Args:
            theta: Parameters (n,) in force.
            seen: Inputs of the decision.

        Raises:
            ObservationError: An input is invalid.
        """
        # Observations are scaled to the robot's whole ranges, whatever the speed limit.
        return Context.of(theta, seen, self._full_space, self.method.layout)

    def decide(self, context: Context) -> Choice:
        """Return the parameters until the next decision.

        Raises what the method raises, and ApplrError if its parameters are not finite.
        """
        theta = self.method.theta(context)
        redrawn = self.stall_rule.redraw(self.method, context, theta)
        clears_costmaps = self.stall_rule.clears_costmaps
        if redrawn is None:
            choice = self._chosen(theta, clears_costmaps)
        else:
            theta = self._with_ordered_speeds(self.space.clip(redrawn))
            choice = Choice(theta, clears_costmaps, STALL)
        self.misses = 0
        return choice

    def miss(self) -> Optional[Choice]:
        """Count a period without a decision.

        Return the defaults once LOST_PERIODS have passed without one. Until then, and if the method
        is static, the parameters stay: None.
        """
        self.misses += 1
        if self.misses == LOST_PERIODS and not self.method.static:
            return self.defaults()
        return None

    def between_courses(self) -> Choice:
        """Return the parameters without a course: those of a static method, else the defaults.

        Raises what the method raises, and ApplrError if its parameters are not finite.
        """
        if not self.method.static:
            return self.defaults()
        return self._chosen(self.method.theta(None))

    def defaults(self) -> Choice:
        """Return the robot's default parameters, theta_0."""
        return Choice(self.space.clip(self._full_space.theta0), False, DEFAULTS)

    def _chosen(self, theta: Array, clears_costmaps: bool = False) -> Choice:
        """Return the choice of the method, which may be that of the default parameters."""
        is_default = np.array_equal(theta, self._full_space.theta0)
        why = DEFAULTS if is_default else METHOD
        return Choice(self.space.clip(theta), clears_costmaps, why)

    def _with_ordered_speeds(self, theta: Array) -> Array:
        """Return parameters (n,) whose smallest speed ahead is at most the largest one.

        The stall rule draws one of them, or the method may choose the largest.
        """
        values = dict(zip(self.space.names, theta))
        if "min_vel_x" in values and "max_vel_x" in values:
            values["min_vel_x"] = min(values["min_vel_x"], values["max_vel_x"])
        return np.array([values[name] for name in self.space.names])
