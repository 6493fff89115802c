"""The move_base state machine without ROS: costmap updates, planner turn, control turn, recoveries, in steps.

The ROS node and the training environment step the same object. One thread, no clock: calls get their time.
Rules: move_base/move_base.cpp; where C++ has a defect that is not copied, a comment says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Optional, Tuple

import numpy as np

from applr_ros1.planner import recovery
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleParameters
from applr_ros1.planner.costmap.scan import LaserScan, project
from applr_ros1.planner.make_plan import free_square, reachable_near
from applr_ros1.planner.navfn.navfn import Navfn
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import JACKAL
from applr_ros1.planner.timer import Timer
from applr_ros1.planner.trajectory.local_planner import LocalPlanner

Pose = Tuple[float, float, float]
Twist = Tuple[float, float]
STOP = (0.0, 0.0)
PLANNING, CONTROLLING, CLEARING, IDLE = "planning", "controlling", "clearing", "idle"
NO_PLAN = np.zeros((0, 3))
INVALID_GOAL = "Aborting on goal because it was sent with an invalid quaternion"
REACHED = "Goal reached."
NO_CONTROL, NO_PATH, OSCILLATING = (
    what + " Even after executing recovery behaviors."
    for what in ("Failed to find a valid control.", "Failed to find a valid plan.", "Robot is oscillating.")
)
COSTMAPS = ("global_costmap", "local_costmap")


@dataclass
class Cycle:
    """What one step did. `command` (v [m/s], w [rad/s]) or None: then nothing is published."""

    command: Optional[Twist] = None
    state: str = IDLE
    result: Optional[Tuple[str, str]] = None  # ("succeeded" | "aborted" | "preempted", text)
    recovery: Optional[Tuple[int, int, str]] = None  # (index, total, name) of a recovery that begins
    planned: bool = False  # the global planner ran
    new_plan: bool = False  # it found a plan: .global_plan
    controlled: bool = False  # the local planner ran
    updated: Tuple[bool, bool] = (False, False)  # the (local, global) costmap had an update
    stale: bool = False  # no scan for scan_timeout: standing still


class MoveBase:
    """`params`: a nested ROS parameter tree; what it leaves out has its default (planner/parameters).

    Raises ParameterError (one line) for parameters that cannot be run.
    """

    def __init__(self, params: Dict[str, Any] = JACKAL):
        self.parameters = complete(params)
        self._config = Configuration(self.parameters)
        self._build()

    # -- the parts -------------------------------------------------------------------------------------------
    def _build(self) -> None:
        """Fresh maps, planners and state from the configuration in force."""
        self.global_costmap, self.local_costmap = (self._make_costmap(name) for name in COSTMAPS)
        static = self.parameters["TrajectoryPlannerROS"]
        self.local_planner = LocalPlanner(
            dict(static, **self._config["TrajectoryPlannerROS"]), self.local_costmap.footprint
        )
        self.navfn = Navfn()
        self.recoveries = recovery.build(self.parameters)
        self._timers = {name: Timer() for name in COSTMAPS}
        self._planner_timer, self._control_timer = Timer(), Timer()
        self._take_frequencies()
        self._scan_timeout = self.parameters["scan_timeout"]
        self._inf_is_valid = self.parameters["local_costmap"]["obstacles_layer"]["scan"]["inf_is_valid"]
        self._cloud = self._scan_stamp = None

        self.goal: Optional[Pose] = None
        self.goal_number = 0  # grows with every goal: a plan belongs to the goal it was made for
        self.global_plan = NO_PLAN
        self.state = PLANNING
        self._trigger = PLANNING
        self._index = 0  # of the next recovery
        self._behaviour = None  # the recovery under way
        self._run_planner = self._woken = self._new_plan = False
        self._cancelled = self._announce_stop = False
        self._refused: Optional[str] = None
        self._retries = 0
        self._oscillation_pose = (0.0, 0.0)
        self._last_plan = self._last_control = self._last_oscillation = 0.0

    def _make_costmap(self, name: str) -> Costmap:
        static, now = self.parameters[name], self._config[name]
        source = static["obstacles_layer"]["scan"]
        obstacles = ObstacleParameters(
            obstacle_range=source["obstacle_range"],
            raytrace_range=source["raytrace_range"],
            source_min_height=source["min_obstacle_height"],
            source_max_height=source["max_obstacle_height"],
            marking=source["marking"],
            clearing=source["clearing"],
            **self._config[name + "/obstacles_layer"],
        )
        return Costmap(
            now["width"],
            now["height"],
            now["resolution"],
            (now["origin_x"], now["origin_y"]),
            rolling=static["rolling_window"],
            footprint=self._footprint(name),
            track_unknown=static["track_unknown_space"],
            obstacles=obstacles,
            inflation=InflationParameters(**self._config[name + "/inflater_layer"]),
        )

    def _footprint(self, name: str) -> np.ndarray:
        """The padded outline (n, 2) of one costmap's parameters."""
        now = self._config[name]
        outline = footprint.parse(now["footprint"])
        if len(outline) < 3:
            outline = footprint.circle(now["robot_radius"])
        return footprint.pad(outline, now["footprint_padding"])

    def _take_frequencies(self) -> None:
        own = self._config[""]
        self._planner_timer.set_frequency(own["planner_frequency"])
        self._control_timer.set_frequency(own["controller_frequency"])
        for name in COSTMAPS:
            self._timers[name].set_frequency(self._config[name]["update_frequency"])

    @property
    def frequency(self) -> float:
        """How often step() wants to be called [Hz]: the fastest of its parts."""
        own = self._config[""]
        return max(
            [own["controller_frequency"], own["planner_frequency"]]
            + [self._config[name]["update_frequency"] for name in COSTMAPS]
        )

    # -- requests between steps ------------------------------------------------------------------------------
    def set_goal(self, goal: Pose, now: float) -> None:
        """A goal (x, y, yaw) in the global frame; replaces the present one.

        Its end shows in a Cycle's result. One that is not finite ends as aborted at the next step.
        """
        goal = tuple(float(v) for v in goal)
        if not all(math.isfinite(v) for v in goal):
            self.refuse_goal(INVALID_GOAL)
            return
        if self.goal is None:
            self._announce_stop = True
        else:
            self._index, self.state, self._behaviour = 0, PLANNING, None
        self.goal = goal
        self.goal_number += 1
        self._new_plan = False  # what was planned for another goal is never driven for this one
        self._cancelled, self._refused = False, None
        self._run_planner = self._woken = True
        self._last_plan = self._last_control = self._last_oscillation = now
        self._retries = 0

    def refuse_goal(self, text: str) -> None:
        """End as aborted, with `text`, at the next step: for a goal that cannot be used."""
        self._refused, self._cancelled = text, False

    def cancel(self, now: float) -> None:
        """Give up the goal at the next step, whatever is under way."""
        self._cancelled = self.goal is not None

    def reset(self, now: float, restore: bool = True) -> None:
        """As a new object: empty maps, no goal, no memory. `restore`: also the start-up parameters."""
        if restore:
            self._config.restore()
        self._build()

    def clear_costmaps(self) -> None:
        """Empty both maps, local first; the last scan marks again at the next update."""
        self.local_costmap.clear()
        self.global_costmap.clear()

    # -- one step --------------------------------------------------------------------------------------------
    def step(self, now: float, pose: Optional[Pose], twist: Twist, scan: Optional[LaserScan] = None) -> Cycle:
        """One turn at time `now` [s]. Parts run when their frequency says so.

        pose (x, y, yaw) in the global frame, or None if it is not known; twist (v, w) as driven; scan: a new
        one, if there is one.
        """
        cycle = Cycle()
        if scan is not None and (self._scan_stamp is None or scan.stamp >= self._scan_stamp):
            self._cloud, self._scan_stamp = project(scan, self._inf_is_valid), scan.stamp
        self._update_maps(now, pose, cycle)
        if self._refused is not None:
            self._end(cycle, "aborted", self._refused)
        elif self._cancelled:
            self._end(cycle, "preempted", "")
        elif self.goal is not None:
            self._take_turns(now, pose, twist, cycle)
        return cycle

    def _update_maps(self, now, pose, cycle) -> None:
        if pose is None or self.goal is None and self._config[""]["shutdown_costmaps"]:
            return
        local, world = self._timers["local_costmap"].due(now), self._timers["global_costmap"].due(now)
        if local:
            self.local_costmap.update(pose, self._cloud)
        if world:
            self.global_costmap.update(pose, self._cloud)
        cycle.updated = local, world

    def _take_turns(self, now, pose, twist, cycle) -> None:
        if self._announce_stop:
            cycle.command, self._announce_stop = STOP, False
        own = self._config[""]
        if self._run_planner:
            # with planner_frequency 0 a failing planner waits for the control turn (C++ spins)
            due = own["planner_frequency"] > 0.0 and self._planner_timer.due(now)
            if self._woken or due:
                if not due:
                    self._planner_timer.restart(now)
                self._plan(now, pose, own, cycle)
        if self._control_timer.due(now):
            self._control(now, pose, twist, own, cycle)
        cycle.state = self.state if self.goal is not None else IDLE

    def _plan(self, now, pose, own, cycle) -> None:
        """Make one plan, as a round of the C++ planner thread does (docs/planner.md, section 8.3)."""
        self._woken, cycle.planned = False, True
        plan = NO_PLAN if pose is None else self.plan(pose, self.goal)
        if len(plan):
            self.global_plan, self._new_plan, cycle.new_plan = plan, True, True
            self._last_plan, self._retries = now, 0
            if self.state == PLANNING:  # C++ also leaves "clearing" here and so skips a due recovery
                self.state = CONTROLLING
            if own["planner_frequency"] <= 0.0:
                self._run_planner = False
        elif self.state == PLANNING:
            self._retries += 1
            limit = own["max_planning_retries"]
            if now > self._last_plan + own["planner_patience"] or 0 <= limit < self._retries:
                self.state, self._trigger, self._run_planner = CLEARING, PLANNING, False
                cycle.command = STOP

    def _control(self, now, pose, twist, own, cycle) -> None:
        """Take one control cycle in executeCycle's order (docs/planner.md, section 8.2)."""
        if pose is not None and _distance(pose, self._oscillation_pose) >= own["oscillation_distance"]:
            self._last_oscillation, self._oscillation_pose = now, (pose[0], pose[1])
            if self._trigger == "oscillation":
                self._index = 0
        if self._scan_is_stale(now):
            cycle.command, cycle.stale = STOP, True
            return
        if self._new_plan:
            self._new_plan = False
            self.local_planner.set_plan(self.global_plan)
            if self._trigger == PLANNING:
                self._index = 0
        if self.state == PLANNING:
            self._run_planner = self._woken = True
        elif self.state == CONTROLLING:
            self._drive(now, pose, twist, own, cycle)
        else:
            self._recover(now, pose, own, cycle)

    def _scan_is_stale(self, now) -> bool:
        if self._scan_timeout <= 0.0:
            return False
        return self._scan_stamp is None or now - self._scan_stamp > self._scan_timeout

    def _drive(self, now, pose, twist, own, cycle) -> None:
        timeout = own["oscillation_timeout"]
        if timeout > 0.0 and self._last_oscillation + timeout < now:
            cycle.command = STOP
            self.state, self._trigger = CLEARING, "oscillation"
        ok, command = False, STOP
        if pose is not None:
            ok, command = self.local_planner.compute_velocity(pose, twist, self.local_costmap)
            cycle.controlled = True
        if ok:
            self._last_control, cycle.command = now, command
            if self._trigger == CONTROLLING:
                self._index = 0
            # read in the cycle that finds it: in C++ the next new plan clears it before it is read
            if self.local_planner.goal_reached:
                self._end(cycle, "succeeded", REACHED)
            return
        cycle.command = STOP
        if now > self._last_control + own["controller_patience"]:
            self.state, self._trigger = CLEARING, CONTROLLING
        else:
            self._last_plan, self._retries = now, 0
            self.state, self._run_planner, self._woken = PLANNING, True, True

    def _recover(self, now, pose, own, cycle) -> None:
        """One turn of the recovery under way, or the next one; aborts when there is none left."""
        if pose is None:
            cycle.command = STOP
            return
        begins = self._behaviour is None
        if begins:
            if not own["recovery_behavior_enabled"] or self._index >= len(self.recoveries):
                texts = {CONTROLLING: NO_CONTROL, PLANNING: NO_PATH}
                self._end(cycle, "aborted", texts.get(self._trigger, OSCILLATING))
                return
            self._behaviour = self.recoveries[self._index]
            cycle.recovery = self._index, len(self.recoveries), self._behaviour.name
            self._behaviour.start(now, pose)
        command = self._behaviour.step(now, pose, self.local_costmap, self.global_costmap)
        if command is not None:
            cycle.command = command
            return
        self._behaviour = None
        cycle.command = STOP  # C++ leaves the base with the rotation's last command
        self._last_oscillation = self._last_plan = now
        self._retries, self.state, self._index = 0, PLANNING, self._index + 1

    def _end(self, cycle, status, text) -> None:
        """Reset: the goal is over, the robot stands."""
        cycle.command, cycle.result, cycle.state = STOP, (status, text), IDLE
        self.goal, self._behaviour, self._refused = None, None, None
        self._run_planner = self._cancelled = self._announce_stop = self._new_plan = False
        self.state, self._trigger, self._index = PLANNING, PLANNING, 0

    # -- plans on request ------------------------------------------------------------------------------------
    def plan(self, start: Pose, goal: Pose, tolerance: Optional[float] = None) -> np.ndarray:
        """A navfn plan (n, 3) from start to goal (x, y, yaw), (0, 3) if there is none: NavfnROS/make_plan."""
        own = self.parameters["NavfnROS"]
        tolerance = own["default_tolerance"] if tolerance is None else tolerance
        return self.navfn.plan(self.global_costmap, start[:2], goal, tolerance, own["allow_unknown"])

    def make_plan(self, start: Pose, goal: Pose, tolerance: float = 0.0) -> np.ndarray:
        """move_base's make_plan: to the goal, else to the first free point of growing squares about it.

        (n, 3); (0, 3) if nothing within `tolerance` [m] can be reached. While a goal is active the node
        refuses the service, and this leaves the maps as they are.
        """
        if not all(math.isfinite(v) for v in tuple(start) + tuple(goal)):
            return NO_PLAN
        own = self._config[""]
        if own["make_plan_clear_costmap"] and self.goal is None:
            for costmap in (self.global_costmap, self.local_costmap):
                free_square(costmap, start, self.parameters["clearing_radius"])
        plan = self.plan(start, goal)
        if not len(plan) and tolerance > 0.0:
            plan = self._plan_near(start, goal, tolerance, own["make_plan_add_unreachable_goal"])
        return plan

    def _plan_near(self, start, goal, tolerance, append_goal) -> np.ndarray:
        unknown = self.parameters["NavfnROS"]["allow_unknown"]
        for x, y in reachable_near(self.global_costmap, start, goal, tolerance, unknown):
            plan = self.plan(start, (x, y, goal[2]))
            if len(plan):
                return np.vstack([plan, goal]) if append_goal else plan
        return NO_PLAN

    # -- parameters ------------------------------------------------------------------------------------------
    def configuration(self, server: str) -> Dict[str, Any]:
        """The values in force of one server ("", "TrajectoryPlannerROS", "local_costmap", ...)."""
        return dict(self._config[server])

    def reconfigure(self, server: str, values: Dict[str, Any]) -> Dict[str, Any]:
        """Take `values` (out of bounds: clamped), return what is in force. ParameterError refuses them whole.

        Maps keep their content unless their size, resolution or origin really changes (C++ always wipes).
        """
        new, old = self._config.request(server, values), self._config[server]
        changed = {name for name in new if new[name] != old[name]}
        if server in COSTMAPS:
            self._check_size(server, new)
        if server == "TrajectoryPlannerROS":
            self.local_planner.reconfigure(new)
        self._config.accept(server, new)
        if server == "" and changed:
            self._take_frequencies()
        elif server in COSTMAPS and changed:
            self._reconfigure_costmap(server, changed)
        elif server.endswith("inflater_layer") and changed:
            getattr(self, server.split("/")[0]).set_inflation(**new)
        elif server.endswith("obstacles_layer") and changed:
            getattr(self, server.split("/")[0]).set_obstacles(**new)
        return dict(new)

    def start_up_configuration(self, server: str) -> Dict[str, Any]:
        """The values one server started with: theta_0 where the parameter files gave it."""
        return self._config.start_up(server)

    def set_footprint(self, name: str, vertices) -> None:
        """An unpadded outline (n, 2) [m] for one costmap, as its footprint topic gives it."""
        vertices = footprint.parse([list(map(float, point)) for point in vertices])
        padding = self._config[name]["footprint_padding"]
        getattr(self, name).set_footprint(footprint.pad(vertices, padding))

    def _check_size(self, name, new) -> None:
        tree = dict(self.parameters)
        tree[name] = dict(tree[name], **new)
        complete(tree)

    def _reconfigure_costmap(self, name, changed) -> None:
        self._timers[name].set_frequency(self._config[name]["update_frequency"])
        if changed & {"width", "height", "resolution", "origin_x", "origin_y"}:
            setattr(self, name, self._make_costmap(name))
        elif changed & {"footprint", "robot_radius", "footprint_padding"}:
            getattr(self, name).set_footprint(self._footprint(name))


def _distance(a, b) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])
