"""State machine of move_base for one goal: planning turns, control turns, recoveries.

MoveBase owns and steps it. The rules are those of move_base/move_base.cpp (planThread,
executeCycle). A comment marks each C++ defect that is not copied. With planner fidelity "cpp-like"
(variant.py), the defects that affect success are copied:

- Finding a plan sets the state to controlling, even from clearing. As long as planning succeeds, a
  stuck robot gets its due recovery only in the rare cycle that no plan precedes.
- Each new plan clears "goal reached" before C++ reads this flag. The robot waits for a cycle
  without a new plan.
- The rotation ends without a zero command.
- recovery.py: clearing recoveries look for a layer named "obstacles", and a blocked rotation has no
  time limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random
from typing import Any, Callable, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.escape import Escape
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.parameters.trees import Values
from applr_ros1.planner.recovery import Behaviour

# Share of a period by which a step may be early and still count, so that jitter skips no turn.
EARLY = 0.2


class Timer:
    """Periodic timer that keeps its phase if polled often enough.

    It skips missed turns, and is never due at 0 Hz.
    """

    __slots__ = ("_period", "_next_turn")

    def __init__(self) -> None:
        self._period = math.inf
        self._next_turn = -math.inf

    def set_frequency(self, frequency: float) -> None:
        """Set the frequency [Hz]. A changed frequency makes the timer due at once."""
        period = 1.0 / frequency if frequency > 0.0 else math.inf
        if period != self._period:
            self._period = period
            self._next_turn = -math.inf

    def due(self, now: float) -> bool:
        """Return whether a turn is due, and if so, start the next period."""
        period = self._period
        if period == math.inf:
            return False
        wait = self._next_turn - now
        if EARLY * period < wait <= period * (1.0 + EARLY):
            return False
        if -period < wait <= EARLY * period:
            self._next_turn += period
        else:
            # The phase starts anew at the first turn, after a missed one, and if the clock went
            # back.
            self._next_turn = now + period
        return True

    def restart(self, now: float) -> None:
        """Make the next turn due one period from now."""
        self._next_turn = now + self._period


STOP = (0.0, 0.0)
NO_PLAN = np.zeros((0, 3))

# States of a goal.
PLANNING = "planning"
CONTROLLING = "controlling"
CLEARING = "clearing"
IDLE = "idle"
OSCILLATION = "oscillation"  # a trigger of recoveries, besides PLANNING and CONTROLLING

# Texts of results, as in C++.
REACHED = "Goal reached."
NO_CONTROL = "Failed to find a valid control. Even after executing recovery behaviors."
NO_PATH = "Failed to find a valid plan. Even after executing recovery behaviors."
OSCILLATING = "Robot is oscillating. Even after executing recovery behaviors."

# Smallest decrease of the distance to the goal that counts as progress [m].
NEARER = 0.5
# Share of control cycles that no plan precedes, for "cpp-like". C++ plans and controls in two
# threads of 20 Hz each. In trials, C++ began due recoveries 6 to 11 s late and reported success 12
# to 18 s late: about one cycle in 200.
LATE = 1.0 / 200.0


@dataclass
class Cycle:
    """Outcome of one step. Nothing is published if `command` (v [m/s], w [rad/s]) is None."""

    command: Optional[Twist] = None
    state: str = IDLE
    # "succeeded", "aborted" or "preempted", and the text.
    result: Optional[Tuple[str, str]] = None
    # Index, total number and name of the recovery that begins.
    recovery: Optional[Tuple[int, int, str]] = None
    planned: bool = False  # whether the global planner ran
    new_plan: bool = False  # whether the global planner found a plan (StateMachine.global_plan)
    controlled: bool = False  # whether the local planner ran
    # Whether the local and the global costmap were updated.
    updated: Tuple[bool, bool] = (False, False)
    stale: bool = False  # whether the robot stands because a source is silent
    silent: Optional[Tuple[str, float]] = None  # topic and timeout [s] of the silent source


@dataclass
class Components:
    """Components that the state machine uses.

    Attributes:
        plan: function from (start, goal) in the global frame to a plan (n, 3), which is (0, 3) if
            there is none.
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
        local_origin: pose of the local costmap's frame in the global one, None if both are the same
            frame.
        twist: measured (v [m/s], w [rad/s]).
        settings: current values of move_base's own server.
        scan_is_stale: whether there is no usable scan.
    """

    time: float
    local_pose: Optional[Pose]
    global_pose: Optional[Pose]
    local_origin: Optional[Pose]
    twist: Twist
    settings: Values
    scan_is_stale: bool


class StateMachine:
    """State machine for one goal, with the times since its last plan and command.

    Args:
        components: planners, costmaps and recoveries.
        random: random source for the timing of a C++-like planner, None for fidelity "ours".

    Attributes:
        goal: goal (x, y, yaw) in the global frame, None if there is none.
        goal_number: number of goals so far. A plan is valid only for its own goal.
        global_plan: latest plan (n, 3).
        state: PLANNING, CONTROLLING or CLEARING.
    """

    def __init__(self, components: Components, random: Optional[Random] = None):
        self._components = components
        self._random = random
        self._like_cpp = random is not None
        self.goal: Optional[Pose] = None
        self.goal_number = 0
        self._refused: Optional[str] = None  # text of a refusal that the next step announces
        self._cancelled = False
        self._announce_stop = False  # whether the next turn begins with a zero command

        # The planner's turn.
        self._planner_timer = Timer()
        self.global_plan = NO_PLAN
        self._run_planner = False
        self._woken = False  # whether the planner runs before its timer is due
        self._new_plan = False  # whether the local planner does not know the plan yet
        self._last_plan = 0.0  # [s]
        self._retries = 0  # unsuccessful plans since then

        # The controller's turn.
        self._control_timer = Timer()
        self.state = PLANNING
        self._last_control = 0.0  # time of the last valid command [s]
        self._oscillation_pose = (0.0, 0.0)  # place from which the robot last got away [m]
        self._last_oscillation = 0.0  # when it did [s]
        self._escape = Escape()

        # Recoveries.
        self._trigger = PLANNING
        self._index = 0  # index of the next recovery
        self._behaviour: Optional[Behaviour] = None  # recovery under way
        self._nearest = math.inf  # least distance to the goal at which recoveries began [m]
        self._rounds = 0  # starts of the first recovery since then

    def set_frequencies(self, planner: float, controller: float) -> None:
        """Set the rates of plans and commands [Hz]."""
        self._planner_timer.set_frequency(planner)
        self._control_timer.set_frequency(controller)

    # -- goals -------------------------------------------------------------------------------------
    def set_goal(self, goal: Pose, now: float) -> None:
        """Set a finite goal (x, y, yaw) in the global frame, which replaces the current one."""
        if self.goal is None:
            self._announce_stop = True
        else:
            # A rotation under way ends here.
            self._announce_stop |= self._behaviour is not None
            self._behaviour = None
            self._index = 0
            self.state = PLANNING
        self.goal = goal
        self.goal_number += 1
        self._new_plan = False  # A plan for the previous goal is never driven for this one.
        self._cancelled = False
        self._refused = None
        self._wake_planner()
        self._nearest = math.inf  # The next recovery begins a new count of rounds.
        self._escape = Escape()
        self._last_control = now
        self._last_oscillation = now
        self._restart_planner_patience(now)

    def refuse_goal(self, text: str) -> None:
        """Abort with `text` at the next step."""
        self._refused = text
        self._cancelled = False

    def cancel(self) -> None:
        """Cancel the goal at the next step."""
        self._cancelled = self.goal is not None

    def report_held(self, held: bool) -> None:
        """Record whether a collision monitor blocked nearly all of the last command.

        C++ has no such input.
        """
        if not self._like_cpp:
            self._escape.report(held)

    def _wake_planner(self) -> None:
        self._run_planner = True
        self._woken = True

    def _restart_planner_patience(self, now: float) -> None:
        self._last_plan = now
        self._retries = 0

    def step(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run the turns of planner and controller if they are due; write the outcome to `cycle`."""
        if self._refused is not None:
            was_driving = self.goal is not None
            self._end(cycle, "aborted", self._refused)
            if not was_driving:
                cycle.command = None  # As in C++, another driver of the base is not disturbed.
        elif self._cancelled:
            self._end(cycle, "preempted", "")
        elif self.goal is not None:
            self._take_turns(inputs, cycle)

    def _take_turns(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run the planner's and the controller's turns of a cycle, those that are due."""
        if self._announce_stop:
            cycle.command = STOP
            self._announce_stop = False
        # In a late cycle, the controller's thread of C++ overtakes the planner's.
        is_late = self._random is not None and self._random.random() < LATE
        if not is_late:
            self._planning_turn(inputs, cycle)
        if self._control_timer.due(inputs.time):
            self._control(inputs, cycle)
        if is_late and self.goal is not None:
            self._planning_turn(inputs, cycle)
        cycle.state = self.state if self.goal is not None else IDLE

    # -- the planner's turn ------------------------------------------------------------------------
    def _planning_turn(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run the planner if it was woken, or if its timer is due."""
        if not self._run_planner:
            return
        # With planner_frequency 0, a failing planner waits for the control turn, whereas C++ spins.
        is_periodic = inputs.settings["planner_frequency"] > 0.0
        is_due = is_periodic and self._planner_timer.due(inputs.time)
        if self._woken and not is_due:
            self._planner_timer.restart(inputs.time)
        if self._woken or is_due:
            self._plan(inputs, cycle)

    def _plan(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run one round of the planner thread."""
        self._woken = False
        cycle.planned = True
        plan = NO_PLAN
        if inputs.global_pose is not None and self.goal is not None:
            plan = self._components.plan(inputs.global_pose, self.goal)
        if len(plan):
            self._take_plan(plan, inputs, cycle)
        elif self.state == PLANNING:
            self._take_failure(inputs, cycle)

    def _take_plan(self, plan: np.ndarray, inputs: CycleInput, cycle: Cycle) -> None:
        self.global_plan = plan
        self._new_plan = True
        cycle.new_plan = True
        # C++ leaves "clearing" here, too, and so skips a due recovery.
        skips_recovery = self._like_cpp and self.state == CLEARING and self._behaviour is None
        if self.state == PLANNING or skips_recovery:
            self.state = CONTROLLING
        if inputs.settings["planner_frequency"] <= 0.0:
            self._run_planner = False

    def _take_failure(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Count an unsuccessful plan, and give up after too many or after planner_patience."""
        settings = inputs.settings
        self._retries += 1
        is_patient = inputs.time <= self._last_plan + settings["planner_patience"]
        most_retries = settings["max_planning_retries"]
        has_retries = most_retries < 0 or self._retries <= most_retries
        if not (is_patient and has_retries):
            self._begin_clearing(PLANNING, cycle)
            self._run_planner = False

    # -- the controller's turn ---------------------------------------------------------------------
    def _control(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run the stages of executeCycle in their order."""
        self._watch_oscillation(inputs)
        if inputs.scan_is_stale:
            cycle.command = STOP
            cycle.stale = True
            return
        if self._new_plan:
            self._new_plan = False
            self._components.local_planner.set_plan(self.global_plan)
            if self._trigger == PLANNING:
                self._index = 0
        if self.state == PLANNING:
            self._wake_planner()
        elif self.state == CONTROLLING:
            self._drive(inputs, cycle)
        else:
            self._recover(inputs, cycle)

    def _watch_oscillation(self, inputs: CycleInput) -> None:
        """Record when the robot has got away by oscillation_distance."""
        if inputs.global_pose is None:
            return
        distance = _distance(inputs.global_pose, self._oscillation_pose)
        if distance >= inputs.settings["oscillation_distance"]:
            x, y, _ = inputs.global_pose
            self._oscillation_pose = (x, y)
            self._last_oscillation = inputs.time
            if self._trigger == OSCILLATION:
                self._index = 0

    def _drive(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run one turn of the local planner, or of an escape motion in its place."""
        now = inputs.time
        local_planner = self._components.local_planner
        if self._like_cpp and local_planner.goal_reached:
            self._end(cycle, "succeeded", REACHED)
            return

        # As in C++, the local planner still gets this turn.
        timeout = inputs.settings["oscillation_timeout"]
        if timeout > 0.0 and self._last_oscillation + timeout < now:
            self._begin_clearing(OSCILLATION, cycle)

        is_valid = False
        command = STOP
        if inputs.local_pose is not None:
            is_valid, command = local_planner.compute_velocity(
                inputs.local_pose,
                inputs.twist,
                self._components.local_costmap,
                inputs.local_origin,
            )
            cycle.controlled = True

        # A robot that its monitor blocks is moved by short motions, and then gets a recovery.
        motion = self._escape.motion(now, not is_valid)
        if motion is not None:
            local_planner.end_escape()
        if self._escape.is_exhausted:
            self._begin_clearing(CONTROLLING, cycle)
        elif motion is not None:
            self._follow(motion, now, cycle)
        elif is_valid:
            self._follow(command, now, cycle)
        else:
            self._miss_command(inputs, cycle)

    def _follow(self, command: Twist, now: float, cycle: Cycle) -> None:
        """Drive a valid command, and end the goal if it is reached."""
        cycle.command = command
        self._last_control = now
        if self._trigger == CONTROLLING and not self._escape.is_held:
            self._index = 0
        # The flag is read in the same cycle. C++ reads it in the next one, after a new plan may
        # have cleared it.
        local_planner = self._components.local_planner
        if local_planner.goal_reached:
            waits_for_cycle = self._like_cpp and local_planner.remembers_reached
            if not waits_for_cycle:
                self._end(cycle, "succeeded", REACHED)

    def _miss_command(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Stop without a valid command. Plan anew, or begin recoveries after a while."""
        if inputs.time > self._last_control + inputs.settings["controller_patience"]:
            self._begin_clearing(CONTROLLING, cycle)
            return
        cycle.command = STOP
        self.state = PLANNING
        self._restart_planner_patience(inputs.time)
        self._wake_planner()

    # -- recoveries --------------------------------------------------------------------------------
    def _begin_clearing(self, trigger: str, cycle: Cycle) -> None:
        """Stop the robot and leave the next control turn to the recoveries."""
        cycle.command = STOP
        self.state = CLEARING
        self._trigger = trigger

    def _recover(self, inputs: CycleInput, cycle: Cycle) -> None:
        """Run one turn of the current recovery, or begin the next one. Abort if none is left."""
        pose = inputs.local_pose
        if pose is None:
            cycle.command = STOP
            return
        if self._behaviour is None:
            self._behaviour = self._next_behaviour(inputs)
            if self._behaviour is None:
                texts = {CONTROLLING: NO_CONTROL, PLANNING: NO_PATH, OSCILLATION: OSCILLATING}
                self._end(cycle, "aborted", texts[self._trigger])
                return
            recovery_count = len(self._components.recoveries)
            cycle.recovery = (self._index, recovery_count, self._behaviour.name)
            self._behaviour.start(inputs.time, pose)

        command = self._behaviour.step(
            inputs.time,
            pose,
            self._components.local_costmap,
            self._components.global_costmap,
            inputs.global_pose,
        )
        if command is not None:
            cycle.command = command
            return

        # The recovery has ended: try again.
        self._behaviour = None
        self._index += 1
        self.state = PLANNING
        self._escape.restart()
        if not self._like_cpp:
            cycle.command = STOP  # C++ leaves the rotation's last command in force.
        self._last_oscillation = inputs.time
        self._restart_planner_patience(inputs.time)

    def _next_behaviour(self, inputs: CycleInput) -> Optional[Behaviour]:
        """Return the recovery that is next in order, None if the goal is to be given up."""
        recoveries = self._components.recoveries
        if not inputs.settings["recovery_behavior_enabled"] or self._index >= len(recoveries):
            return None
        if self._rounds_are_over(inputs.global_pose):
            return None
        return recoveries[self._index]

    def _rounds_are_over(self, global_pose: Any) -> bool:
        """Return whether recoveries began recovery_rounds times without bringing the goal nearer.

        In C++, each valid command restarts the sequence, without a limit. If the goal is enclosed,
        each conservative reset clears the maps. The robot then sets out, detects the obstacles
        again and returns to the first recovery.
        """
        if self._index > 0:
            return False
        distance = _distance(global_pose, self.goal)
        if distance <= self._nearest - NEARER:
            self._nearest = distance
            self._rounds = 0
        self._rounds += 1
        return 0 < self._components.recovery_rounds < self._rounds

    def _end(self, cycle: Cycle, status: str, text: str) -> None:
        """End the goal with a result: reset the state and stop the robot."""
        cycle.command = STOP
        cycle.result = (status, text)
        cycle.state = IDLE
        self.goal = None
        self._refused = None
        self._cancelled = False
        self._announce_stop = False
        self._run_planner = False
        self._new_plan = False
        self.state = PLANNING
        self._trigger = PLANNING
        self._index = 0
        self._behaviour = None


def _distance(a: Any, b: Any) -> float:
    """Return the distance [m] of two poses or points (x, y, ...)."""
    return math.hypot(a[0] - b[0], a[1] - b[1])
