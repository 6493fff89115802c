"""Supervisor of the Pilot on the robot: it says when a decision is due, and never makes one.

The applr node brings goals and inputs to the supervisor, and requests the choices that it returns.
Between goals, and while the method is off, the planner has parameters that need no decision.
All times are those of the node's clock [s].
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Callable, Dict, Mapping, NamedTuple, Optional

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import one_line
from applr_ros1.policy.decision import PERIOD, Context, Method
from applr_ros1.policy.pilot import LOST_PERIODS, STALL, Choice, Pilot

LATE_SHARE = 0.1  # delay above which a decision counts as late, as a share of the period
# Whose parameters are in force, in words
DEFAULT_PARAMETERS = "the robot's default parameters"
PARAMETERS_BY_HAND = "the parameters set by hand"


class Ruling(NamedTuple):
    """Result of a decision that was due.

    Attributes:
        number: Number of the decision.
        theta: Parameters (n,) decided, or None if the method failed.
        refused: Reason why the method failed, or "".
        clears_costmaps: Whether both costmaps are to be cleared before the parameters take effect.
        request: Choice to be put in force, or None if the parameters stay.
    """

    number: int
    theta: Optional[Array]
    refused: str
    clears_costmaps: bool
    request: Optional[Choice]


class Supervisor:
    """Begins and ends courses, and asks the pilot once per period while there is a goal.

    Between goals the planner has the parameters set by hand, those of a static method, or the
    defaults. Each course therefore starts with them.

    Args:
        pilot: Pilot of the robot.
        seed: Seed of the first course; further courses use seed + 1, seed + 2 ...
        on_trouble: Called with a problem in one line.

    Attributes:
        enabled: Whether the method is on.
        degraded: Reason why the requested method is not in use, or "".
        counts: Numbers of courses and decisions, and of those that were late, refused by the method
            or without usable inputs.
        goal: Id of the present goal, or None.
        has_rested: Whether the parameters for the time between goals have been returned by rest().
        began: Time of the start of the course; NaN before the first one.
        due: Time of the next decision; infinite before the first course.
        last: Time of the last decision of the course, or None.
    """

    def __init__(self, pilot: Pilot, seed: int, on_trouble: Callable[[str], None]):
        self.pilot = pilot
        self.seed = seed
        self.enabled = True
        self.degraded = ""
        self.counts: Dict[str, int] = Counter()
        self.goal: Optional[str] = None
        self.has_rested = False
        self.began = math.nan
        self.due = math.inf
        self.last: Optional[float] = None
        self._on_trouble = on_trouble
        self._latest: Optional[Choice] = None  # latest choice of any kind
        self._beat_due: Optional[float] = None  # time of the next heartbeat; None before the first

    # -- what people ask for -----------------------------------------------------------------------
    def switch(self, enabled: bool) -> None:
        """Switch the method on or off.

        When it is off, the planner has its default parameters and no decisions are made.
        """
        if enabled and self.enabled:
            return
        self.enabled = enabled
        self.has_rested = False
        self.pilot.by_hand = None

    def set_by_hand(self, values: Mapping[str, float], theta: Optional[Array]) -> Choice:
        """Switch the method off, and return a person's choice (Pilot.set_by_hand)."""
        choice = self.pilot.set_by_hand(values, theta)
        self.enabled = False
        return choice

    def change_method(self, method: Method, now: float) -> None:
        """Replace the method. In the middle of a course, the new method decides at once."""
        self.pilot.method = method
        self.degraded = ""
        if self.goal is None or method.static:
            self.has_rested = False
        else:
            self._begin_course(now)

    # -- courses -----------------------------------------------------------------------------------
    def rest(self) -> Choice:
        """Return the parameters for the time between goals."""
        self.has_rested = True
        self._latest = self._resting_choice()
        return self._latest

    def _resting_choice(self) -> Choice:
        if self.pilot.by_hand is not None:
            return self.pilot.by_hand
        if self.enabled:
            try:
                return self.pilot.between_courses()
            except Exception as problem:  # A method may be user code: the node goes on in any case.
                self.degraded = one_line(problem)
        return self.pilot.defaults()

    def forget_course(self) -> Choice:
        """Drop the course after the clock jumped back, and return the parameters between goals."""
        self.goal = None
        self.due = math.inf
        self.last = None
        self._beat_due = None
        return self.rest()

    def pursue(self, goal: Optional[str], now: float) -> Optional[Choice]:
        """Begin a course if the goal is new, or end it if there is none.

        Returns:
            The parameters after the end of a course, else None.
        """
        if goal == self.goal:
            return None
        self.goal = goal
        self.last = None
        if goal is None:
            return self.rest()
        self._begin_course(now)
        return None

    def _begin_course(self, now: float) -> None:
        """Reset the pilot for a new goal. Its first decision is due at once."""
        try:
            self.pilot.begin(self.seed + self.counts["courses"])
        except Exception as problem:  # A method may be user code, as in _resting_choice.
            self._on_trouble(one_line(problem))
        self.counts["courses"] += 1
        self.began = now
        self.due = now

    # -- decisions ---------------------------------------------------------------------------------
    def is_due(self, now: float, is_settled: bool) -> bool:
        """Return whether a decision is due.

        Args:
            now: Time.
            is_settled: Whether the parameters before the course are in force. The first decision of
                a course waits for them, for one period at most.
        """
        if self.goal is None or now < self.due:
            return False
        waits = self.last is None and not is_settled and now - self.due < self.pilot.period
        return not waits

    def miss_inputs(self, now: float, problem: str) -> Optional[Choice]:
        """Note that inputs of a due decision are missing; it counts after a whole period.

        Return the parameters to be put in force, or None if they stay.
        """
        if now - self.due < self.pilot.period:
            return None
        self.due = now
        return self._miss("unusable", problem)

    def decide(self, now: float, context: Context) -> Ruling:
        """Make the decision that is due."""
        # The first decision waits for the first plan. It sets the time of the later ones, of which
        # a late one does not delay the next one.
        period = self.pilot.period
        delay = 0.0
        if self.last is not None:
            delay = now - self.due
        self.counts["late"] += delay > LATE_SHARE * period
        self.counts["decisions"] += 1
        self.due = now + max(period - delay, period / 2)
        self.last = now

        number = self.counts["decisions"]
        try:
            choice = self.pilot.decide(context)
        except Exception as problem:  # A method may be user code, as in _resting_choice.
            refused = one_line(problem)
            request = self._miss("refused", f"decision refused, parameters unchanged: {refused}")
            return Ruling(number, None, refused, False, request)

        # During a course, the choice of a static method is requested only after a stall, because
        # other parameters may have been set by hand since.
        was_method = self._latest is None or self._latest.why != STALL
        stays = self.pilot.method.static and choice.why != STALL and was_method
        self._latest = choice
        request = None if stays else choice
        return Ruling(number, choice.theta, "", choice.clears_costmaps, request)

    def _miss(self, kind: str, problem: str) -> Optional[Choice]:
        """Count a period without a decision, and return the pilot's fallback, if any."""
        self.counts[kind] += 1
        self._on_trouble(problem)
        choice = self.pilot.miss()
        if choice is not None:
            self._on_trouble(f"no decision for {LOST_PERIODS} periods: back to theta_0")
        return choice

    # -- heartbeats --------------------------------------------------------------------------------
    def is_beat_due(self, now: float) -> bool:
        """Return whether a heartbeat is due: after a decision period, but at least each PERIOD.

        move_base expects a beat every PERIOD, however long the decision period is.
        """
        return self._beat_due is None or now >= self._beat_due

    def beat(self, now: float) -> bool:
        """Note a heartbeat.

        Returns:
            Whether it came late by more than a period. move_base may then have restored its
            start-up values in the meantime.
        """
        period = min(self.pilot.period, PERIOD)
        has_gap = self._beat_due is not None and now - self._beat_due > period
        self._beat_due = now + period
        return has_gap

    # -- state in words ----------------------------------------------------------------------------
    @property
    def in_force(self) -> str:
        """Parameters with which the planner drives as soon as its servers answer, in words."""
        if self.pilot.by_hand is not None:
            return PARAMETERS_BY_HAND
        method = self.pilot.method
        decides = self.last is not None and not self.pilot.has_lost_method
        if self.enabled and (method.static or decides):
            return f"the parameters of method {method.name}"
        return DEFAULT_PARAMETERS

    @property
    def activity(self) -> str:
        """Activity of the node, in words."""
        if not self.enabled:
            return f"switched off: {self.in_force} drive now"
        if self.goal is None:
            return "idle: no goal"
        return "deciding"

    @property
    def is_degraded(self) -> bool:
        """True if the requested method does not drive although it is asked for."""
        return bool(self.degraded) or self.pilot.has_lost_method
