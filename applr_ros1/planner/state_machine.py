"""State machine of move_base for one goal: planning turns, control turns, recoveries. MoveBase owns and steps it.

The rules are those of move_base/move_base.cpp (planThread, executeCycle). A comment marks each C++ defect that is not
copied. With planner fidelity "cpp-like" (variant.py), the defects that affect success are copied:

- Finding a plan sets the state to controlling, even from clearing. As long as planning succeeds, a stuck robot gets
  its due recovery only in the rare cycle that no plan precedes.
- Each new plan clears "goal reached" before C++ reads this flag. The robot waits for a cycle without a new plan.
- The rotation ends without a zero command.
- recovery.py: clearing recoveries look for a layer named "obstacles", and a blocked rotation has no time limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random
from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.escape import Escape
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.recovery import Behaviour

EARLY = 0.2  # share of a period by which a step may be early and still count, so that jitter skips no turn


class Timer:
    """Periodic timer that keeps its phase if polled often enough. It skips missed turns, and is never due at 0 Hz."""

    __slots__ = ("_period", "_next")

    def __init__(self) -> None:
        self._period, self._next = math.inf, -math.inf

    def set_frequency(self, frequency: float) -> None:
        """Set the frequency [Hz]. A changed frequency makes the timer due at once."""
        period = 1.0 / frequency if frequency > 0.0 else math.inf
        if period != self._period:
            self._period, self._next = period, -math.inf

    def due(self, now: float) -> bool:
        """Return whether a turn is due, and if so, start the next period."""
        period = self._period
        if period == math.inf:
            return False
        wait = self._next - now
        if EARLY * period < wait <= period * (1.0 + EARLY):
            return False
        # The phase starts anew at the first turn, after a missed turn, and if the clock went back.
        self._next = now + period if not -period < wait <= EARLY * period else self._next + period
        return True

    def restart(self, now: float) -> None:
        """Make the next turn due one period from now."""
        self._next = now + self._period


Twist = Tuple[float, float]
STOP = (0.0, 0.0)
PLANNING, CONTROLLING, CLEARING, IDLE = "planning", "controlling", "clearing", "idle"
NO_PLAN = np.zeros((0, 3))
REACHED = "Goal reached."
NO_CONTROL, NO_PATH, OSCILLATING = (
    cause + " Even after executing recovery behaviors."
    for cause in (
        "Failed to find a valid control.",
        "Failed to find a valid plan.",
        "Robot is oscillating.",
    )
)
NEARER = 0.5  # smallest decrease of the distance to the goal that counts as progress [m]
# Share of control cycles that no plan precedes, for "cpp-like". C++ plans and controls in two threads of 20 Hz each.
# In trials, C++ began due recoveries 6 to 11 s late and reported success 12 to 18 s late: about one cycle in 200.
LATE = 1.0 / 200.0


@dataclass
class Cycle:
    """Outcome of one step. Nothing is published if `command` (v [m/s], w [rad/s]) is None."""

    command: Optional[Twist] = None
    state: str = IDLE
    result: Optional[Tuple[str, str]] = None  # ("succeeded" | "aborted" | "preempted", text)
    recovery: Optional[Tuple[int, int, str]] = (
        None  # (index, total, name) of the recovery that begins
    )
    planned: bool = False  # whether the global planner ran
    new_plan: bool = False  # whether the global planner found a plan (StateMachine.global_plan)
    controlled: bool = False  # whether the local planner ran
    updated: Tuple[bool, bool] = (False, False)  # whether the (local, global) costmap was updated
    stale: bool = False  # whether the robot stands because a source is silent
    silent: Optional[Tuple[str, float]] = None  # topic and timeout [s] of the silent source


@dataclass
class Components:
    """Components that the state machine uses.

    Attributes:
        plan: function from (start, goal) in the global frame to a plan (n, 3), which is (0, 3) if there is none.
        recovery_rounds: value of applr/recovery_rounds.
    """

    local_planner: LocalPlanner
    local_costmap: Costmap
    global_costmap: Costmap
    recoveries: Sequence[Behaviour]
    plan: Callable[[Pose, Pose], np.ndarray]
    recovery_rounds: int


class CycleInput(NamedTuple):
    """Inputs of one step.

    Attributes:
        time: current time [s].
        local_pose: robot pose (x, y, yaw) in the local costmap's frame, None if unknown.
        global_pose: robot pose in the global costmap's frame.
        local_origin: pose of the local costmap's frame in the global one, None if both are the same frame.
        twist: measured (v [m/s], w [rad/s]).
        settings: current values of move_base's own server.
        scan_is_stale: whether there is no usable scan.
    """

    time: float
    local_pose: Optional[Pose]
    global_pose: Optional[Pose]
    local_origin: Optional[Pose]
    twist: Twist
    settings: Dict[str, Any]
    scan_is_stale: bool


class StateMachine:
    """State machine for one goal, with the times since its last plan and command.

    random: random source for the timing of a C++-like planner, None for planner fidelity "ours".
    """

    def __init__(self, components: Components, random: Optional[Random] = None):
        self._components = components
        self._random = random
        self._like_cpp = random is not None
        self._planner_timer, self._control_timer = Timer(), Timer()
        self.goal: Optional[Pose] = None
        self.goal_number = 0  # number of goals so far: a plan is valid only for its own goal
        self.global_plan = NO_PLAN
        self.state = PLANNING
        self._trigger = PLANNING
        self._index = 0  # index of the next recovery
        self._behaviour: Optional[Behaviour] = None  # recovery under way
        self._run_planner = self._woken = self._new_plan = False
        self._cancelled = self._announce_stop = False
        self._refused: Optional[str] = None
        self._retries = 0
        self._oscillation_pose = (0.0, 0.0)
        self._last_plan = self._last_control = self._last_oscillation = 0.0
        self._rounds, self._nearest = (
            0,
            math.inf,
        )  # starts of the first recovery since the least goal distance [m]
        self._escape = Escape()

    def set_frequencies(self, planner: float, controller: float) -> None:
        """Set the rates of plans and commands [Hz]."""
        self._planner_timer.set_frequency(planner)
        self._control_timer.set_frequency(controller)

    # -- goals -----------------------------------------------------------------------------------------------
    def set_goal(self, goal: Pose, now: float) -> None:
        """Set a finite goal (x, y, yaw) in the global frame, which replaces the current one."""
        if self.goal is None:
            self._announce_stop = True
        else:
            self._announce_stop |= self._behaviour is not None  # A rotation under way ends here.
            self._index, self.state, self._behaviour = 0, PLANNING, None
        self.goal = goal
        self.goal_number += 1
        self._new_plan = False  # A plan for the previous goal is never driven for this one.
        self._cancelled, self._refused = False, None
        self._run_planner = self._woken = True
        self._rounds, self._nearest, self._escape = 0, math.inf, Escape()
        self._restart_patience(now)

    def refuse_goal(self, text: str) -> None:
        """Abort with `text` at the next step."""
        self._refused, self._cancelled = text, False

    def cancel(self) -> None:
        """Cancel the goal at the next step."""
        self._cancelled = self.goal is not None

    def report_held(self, held: bool) -> None:
        """Record whether a collision monitor blocked nearly all of the last command. C++ has no such input."""
        if not self._like_cpp:
            self._escape.report(held)

    def _restart_patience(self, now: float) -> None:
        self._last_plan = self._last_control = self._last_oscillation = now
        self._retries = 0

    def step(self, given: CycleInput, cycle: Cycle) -> None:
        """Run the planner's and the controller's turn if they are due, and write the outcome to `cycle`."""
        if self._refused is not None:
            was_driving = self.goal is not None
            self._end(cycle, "aborted", self._refused)
            if not was_driving:
                cycle.command = None  # As in C++, another driver of the base is not disturbed.
        elif self._cancelled:
            self._end(cycle, "preempted", "")
        elif self.goal is not None:
            self._take_turns(given, cycle)

    def _take_turns(self, given: CycleInput, cycle: Cycle) -> None:
        if self._announce_stop:
            cycle.command, self._announce_stop = STOP, False
        late = self._random is not None and self._random.random() < LATE
        if not late:
            self._planning_turn(given, cycle)
        if self._control_timer.due(given.time):
            self._control(given, cycle)
        if late and self.goal is not None:
            self._planning_turn(given, cycle)
        cycle.state = self.state if self.goal is not None else IDLE

    # -- the planner's turn ----------------------------------------------------------------------------------
    def _planning_turn(self, given: CycleInput, cycle: Cycle) -> None:
        if not self._run_planner:
            return
        # With planner_frequency 0, a failing planner waits for the control turn, whereas C++ spins.
        due = given.settings["planner_frequency"] > 0.0 and self._planner_timer.due(given.time)
        if self._woken or due:
            if not due:
                self._planner_timer.restart(given.time)
            self._plan(given, cycle)

    def _plan(self, given: CycleInput, cycle: Cycle) -> None:
        """Run one round of the planner thread."""
        now, settings = given.time, given.settings
        self._woken, cycle.planned = False, True
        global_pose = given.global_pose
        plan = (
            NO_PLAN
            if global_pose is None or self.goal is None
            else self._components.plan(global_pose, self.goal)
        )
        if len(plan):
            self.global_plan, self._new_plan, cycle.new_plan = plan, True, True
            self._last_plan, self._retries = now, 0
            skipped = self._like_cpp and self.state == CLEARING and self._behaviour is None
            if (
                self.state == PLANNING or skipped
            ):  # C++ leaves "clearing" here, too, and so skips a due recovery.
                self.state = CONTROLLING
            if settings["planner_frequency"] <= 0.0:
                self._run_planner = False
        elif self.state == PLANNING:
            self._retries += 1
            limit = settings["max_planning_retries"]
            if now > self._last_plan + settings["planner_patience"] or 0 <= limit < self._retries:
                self.state, self._trigger, self._run_planner = CLEARING, PLANNING, False
                cycle.command = STOP

    # -- the controller's turn -------------------------------------------------------------------------------
    def _control(self, given: CycleInput, cycle: Cycle) -> None:
        """Run the stages of executeCycle in their order."""
        now, global_pose, settings = given.time, given.global_pose, given.settings
        if (
            global_pose is not None
            and _distance(global_pose, self._oscillation_pose) >= settings["oscillation_distance"]
        ):
            self._last_oscillation, self._oscillation_pose = now, (global_pose[0], global_pose[1])
            if self._trigger == "oscillation":
                self._index = 0
        if given.scan_is_stale:
            cycle.command, cycle.stale = STOP, True
            return
        if self._new_plan:
            self._new_plan = False
            self._components.local_planner.set_plan(self.global_plan)
            if self._trigger == PLANNING:
                self._index = 0
        if self.state == PLANNING:
            self._run_planner = self._woken = True
        elif self.state == CONTROLLING:
            self._drive(given, cycle)
        else:
            self._recover(given, cycle)

    def _drive(self, given: CycleInput, cycle: Cycle) -> None:
        now, pose, settings = given.time, given.local_pose, given.settings
        local_planner = self._components.local_planner
        if self._like_cpp and local_planner.goal_reached:
            self._end(cycle, "succeeded", REACHED)
            return
        timeout = settings["oscillation_timeout"]
        if timeout > 0.0 and self._last_oscillation + timeout < now:
            cycle.command = STOP
            self.state, self._trigger = CLEARING, "oscillation"
        ok, command = False, STOP
        if pose is not None:
            ok, command = local_planner.compute_velocity(
                pose, given.twist, self._components.local_costmap, given.local_origin
            )
            cycle.controlled = True
        motion = self._escape_motion(now, not ok)
        if self._escape.is_exhausted:
            cycle.command = STOP
            self.state, self._trigger = CLEARING, CONTROLLING
            return
        if motion is not None:
            ok, command = True, motion
        if ok:
            self._last_control, cycle.command = now, command
            if self._trigger == CONTROLLING and not self._escape.is_held:
                self._index = 0
            # The flag is read in the same cycle. C++ reads it in the next one, after a new plan may have cleared it.
            if local_planner.goal_reached and not (
                self._like_cpp and local_planner.remembers_reached
            ):
                self._end(cycle, "succeeded", REACHED)
            return
        cycle.command = STOP
        if now > self._last_control + settings["controller_patience"]:
            self.state, self._trigger = CLEARING, CONTROLLING
        else:
            self._last_plan, self._retries = now, 0
            self.state, self._run_planner, self._woken = PLANNING, True, True

    def _escape_motion(self, now: float, blocked: bool) -> Optional[Twist]:
        """Return the motion that frees a robot blocked by its monitor, or None for the local planner's command."""
        motion = self._escape.instead(now, blocked)
        if motion is not None:
            self._components.local_planner.end_escape()
        return motion

    def _recover(self, given: CycleInput, cycle: Cycle) -> None:
        """Run one turn of the current recovery, or begin the next one. Abort if none is left."""
        now, pose, components = given.time, given.local_pose, self._components
        if pose is None:
            cycle.command = STOP
            return
        behaviour = self._behaviour
        if behaviour is None:
            left = given.settings["recovery_behavior_enabled"] and self._index < len(
                components.recoveries
            )
            if not left or self._rounds_are_over(given.global_pose):
                texts = {CONTROLLING: NO_CONTROL, PLANNING: NO_PATH}
                self._end(cycle, "aborted", texts.get(self._trigger, OSCILLATING))
                return
            self._behaviour = behaviour = components.recoveries[self._index]
            cycle.recovery = self._index, len(components.recoveries), behaviour.name
            behaviour.start(now, pose)
        command = behaviour.step(
            now, pose, components.local_costmap, components.global_costmap, given.global_pose
        )
        if command is not None:
            cycle.command = command
            return
        self._behaviour = None
        self._escape.restart()
        if not self._like_cpp:
            cycle.command = STOP  # C++ leaves the rotation's last command in force.
        self._last_oscillation = self._last_plan = now
        self._retries, self.state, self._index = 0, PLANNING, self._index + 1

    def _rounds_are_over(self, global_pose: Any) -> bool:
        """Return whether the recoveries began recovery_rounds times without bringing the robot nearer to its goal.

        In C++, each valid command restarts the sequence, without a limit. If the goal is enclosed, each conservative
        reset clears the maps. The robot then sets out, detects the obstacles again and returns to the first recovery.
        """
        if self._index > 0:
            return False
        distance = _distance(global_pose, self.goal)
        if distance <= self._nearest - NEARER:
            self._nearest, self._rounds = distance, 0
        self._rounds += 1
        return 0 < self._components.recovery_rounds < self._rounds

    def _end(self, cycle: Cycle, status: str, text: str) -> None:
        """End the goal with a result: reset the state and stop the robot."""
        cycle.command, cycle.result, cycle.state = STOP, (status, text), IDLE
        self.goal, self._behaviour, self._refused = None, None, None
        self._run_planner = self._cancelled = self._announce_stop = self._new_plan = False
        self.state, self._trigger, self._index = PLANNING, PLANNING, 0


def _distance(a: Any, b: Any) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])
