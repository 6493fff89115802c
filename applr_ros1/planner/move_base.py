"""move_base without ROS, advanced in steps: costmaps, planners, recoveries, parameters, requests.

The ROS node and the training environment step the same class. It runs in one thread and has neither
a clock nor a random source: time and seed are arguments. state_machine.py handles the goals.
"""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Optional, Sequence, Set, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, Twist, compose, inverse
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner import recovery
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.static_layer import StaticLayer, StaticMap
from applr_ros1.planner.factory import make_costmap, make_local_planner
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.make_plan import free_square, reachable_near
from applr_ros1.planner.navfn.navfn import Navfn
from applr_ros1.planner.observation_router import ObservationRouter, Sensed
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import Server, namespace
from applr_ros1.planner.parameters.layers import COSTMAPS
from applr_ros1.planner.parameters.settings import Settings, are_in_force
from applr_ros1.planner.parameters.trees import Tree, Values
from applr_ros1.planner.state_machine import (
    NO_PLAN,
    Components,
    Cycle,
    CycleInput,
    StateMachine,
    Timer,
)
from applr_ros1.planner.variant import CPP_LIKE, LATENESS_STREAM, OURS, draw, generator

INVALID_GOAL = "Aborting on goal because it was sent with an invalid quaternion"


class MoveBase:
    """Complete move_base, advanced by `step`.

    Args:
        params: nested ROS parameter tree. Missing parameters have their defaults
            (planner/parameters).
        planner: planner fidelity, see variant.py.
        seed: int or sequence of ints, used until `reset` gives another one. With "drawn", the seed
            determines the planner fidelity, and with "cpp-like", the cycles whose plan comes late
            (state_machine.LATE).

    Attributes:
        parameters: complete parameter tree.
        local_planner_name: namespace of the local planner.
        local_costmap, global_costmap: costmaps.
        navfn: global planner.
        recoveries: recovery behaviours in order.
        variant: current planner fidelity, "ours" or "cpp-like".
        local_origin: pose (x, y, yaw) of the local costmap's frame in the global one at the last
            step, None if they are the same.

    Raises:
        ParameterError, ApplrError: the parameters cannot be used. The message has one line.
    """

    def __init__(self, params: Tree, planner: str = OURS, seed: Union[int, Sequence[int]] = 0):
        self.parameters = complete(params)
        self.local_planner_name = namespace(self.parameters["base_local_planner"])
        self._config = Configuration(self.parameters)
        self._planner = planner
        self._seed = seed
        # What was received on topics outlives a rebuild: maps by topic, and unpadded footprints
        # (n, 2) [m] by costmap.
        self._maps: Dict[str, StaticMap] = {}
        self._outlines: Dict[str, np.ndarray] = {}
        self._build()

    # -- components --------------------------------------------------------------------------------
    def _build(self) -> None:
        """Create costmaps, planners and state from the current configuration."""
        self.global_costmap = self._make_costmap("global_costmap")
        self.local_costmap = self._make_costmap("local_costmap")
        self.navfn = Navfn()
        self.variant = draw(self._planner, self._seed)
        is_like_cpp = self.variant == CPP_LIKE
        self.recoveries = recovery.build(self.parameters, is_like_cpp)
        self._components = Components(
            make_local_planner(self.parameters, self._config),
            self.local_costmap,
            self.global_costmap,
            self.recoveries,
            self.plan,
            self.parameters["applr"]["recovery_rounds"],
        )
        random_source = generator(self._seed, LATENESS_STREAM) if is_like_cpp else None
        self._machine = StateMachine(self._components, random_source)
        self._timers = {name: Timer() for name in COSTMAPS}
        self._take_frequencies()
        self._router = ObservationRouter(
            self.local_costmap, self.global_costmap, self.parameters["scan_timeout"]
        )
        self.local_origin: Optional[Pose] = None
        for topic, static_map in self._maps.items():
            self._show_map(topic, static_map)
        for name in self._outlines:
            self._show_footprint(name)

    def _make_costmap(self, name: str) -> Costmap:
        return make_costmap(name, self.parameters[name], self._config)

    def _take_frequencies(self) -> None:
        settings = self._config[""]
        self._machine.set_frequencies(
            settings["planner_frequency"], settings["controller_frequency"]
        )
        for name in COSTMAPS:
            self._timers[name].set_frequency(self._config[name]["update_frequency"])

    @property
    def frequency(self) -> float:
        """Rate at which step() must be called [Hz]: the highest rate of its components."""
        settings = self._config[""]
        update_frequencies = [self._config[name]["update_frequency"] for name in COSTMAPS]
        turn_frequencies = [settings["controller_frequency"], settings["planner_frequency"]]
        return float(max(turn_frequencies + update_frequencies))

    @property
    def local_planner(self) -> LocalPlanner:
        """Local planner in use. It can be replaced."""
        return self._components.local_planner

    @local_planner.setter
    def local_planner(self, planner: LocalPlanner) -> None:
        self._components.local_planner = planner

    @property
    def goal_tolerance(self) -> float:
        """Distance to the goal within which the local planner counts it as reached [m]."""
        planner_name = self.local_planner_name
        # Not every planner has this parameter on its server.
        values = dict(self.parameters[planner_name], **self._config[planner_name])
        return float(values["xy_goal_tolerance"])

    # -- requests between steps --------------------------------------------------------------------
    def set_goal(self, goal: Pose, now: float) -> None:
        """Set the goal (x, y, yaw) in the global frame, which replaces the current one.

        The result appears in a later Cycle. A goal that is not finite is aborted at the next step.
        """
        x, y, yaw = (float(number) for number in goal)
        if all(map(math.isfinite, (x, y, yaw))):
            self._machine.set_goal((x, y, yaw), now)
        else:
            self.refuse_goal(INVALID_GOAL)

    def refuse_goal(self, text: str) -> None:
        """Abort with `text` at the next step, because the goal cannot be used."""
        self._machine.refuse_goal(text)

    def cancel(self) -> None:
        """Cancel the goal at the next step, in any state."""
        self._machine.cancel()

    def report_held(self, held: bool) -> None:
        """Record whether a collision monitor blocked nearly all of the last command.

        This is Verdict.blocked of the monitor.
        """
        self._machine.report_held(held)

    def reset(
        self, now: float, restore: bool = True, seed: Union[int, Sequence[int], None] = None
    ) -> None:
        """Reset to the state of a new object: empty maps, no goal, no memory.

        Args:
            now: time [s].
            restore: whether to restore the start-up parameters, too.
            seed: new seed (see the class). None keeps the last one, and thus the planner fidelity.
        """
        if seed is not None:
            self._seed = seed
        if restore:
            self._config.restore_start_up()
            self._outlines.clear()
        self._build()

    def clear_costmaps(self) -> None:
        """Clear both costmaps, the local one first. The next update marks the last scan again."""
        self.local_costmap.reset_layers()
        self.global_costmap.reset_layers()

    # -- maps --------------------------------------------------------------------------------------
    @property
    def costmaps(self) -> Dict[str, Costmap]:
        """Both costmaps by name."""
        return {"global_costmap": self.global_costmap, "local_costmap": self.local_costmap}

    @property
    def _static_layers(self) -> List[StaticLayer]:
        """Static layers of both costmaps, those of the global one first."""
        return self.global_costmap.static_layers + self.local_costmap.static_layers

    @property
    def map_topics(self) -> Dict[str, bool]:
        """Topics of the maps that static layers need, and whether one of them takes updates."""
        topics: Dict[str, bool] = {}
        for layer in self._static_layers:
            parameters = layer.parameters
            takes_updates = topics.get(parameters.map_topic, False)
            topics[parameters.map_topic] = takes_updates or parameters.subscribe_to_updates
        return topics

    @property
    def missing_map(self) -> str:
        """Topic of a map that a static layer still waits for, or "" if there is none."""
        for layer in self._static_layers:
            if layer.is_waiting:
                return layer.parameters.map_topic
        return ""

    def set_map(self, given: StaticMap, topic: str = "") -> None:
        """Set the map of the static layers that listen to a topic. A reset keeps the map.

        Args:
            given: map.
            topic: topic of the map, by default the first of map_topics.

        Raises:
            ApplrError: the map cannot be used. Nothing is changed.
        """
        topic = topic or next(iter(self.map_topics), "")
        static_map = given.checked()
        self._check_frame(topic, static_map)
        # Kept for the next reset, unless all layers have taken their first and only map.
        if topic not in self._maps or self._is_accepted(topic):
            self._maps[topic] = static_map
        self._show_map(topic, static_map)

    def _is_accepted(self, topic: str) -> bool:
        listeners = [layer for layer in self._static_layers if layer.parameters.map_topic == topic]
        return any(layer.accepts() for layer in listeners)

    def _show_map(self, topic: str, static_map: StaticMap) -> None:
        for costmap in self.costmaps.values():
            costmap.set_map(topic, static_map)

    def _check_frame(self, topic: str, static_map: StaticMap) -> None:
        """Raise ApplrError if a rolling costmap cannot use a map because of its frame."""
        if static_map.frame in ("", *self._global_frames):
            return
        for name, costmap in self.costmaps.items():
            topics = [layer.parameters.map_topic for layer in costmap.static_layers]
            if costmap.rolling and topic in topics:
                frames = " or ".join(self._global_frames)
                raise ApplrError(
                    f"the map on {topic} is in frame {static_map.frame}, "
                    f"which the rolling {name} cannot use: publish it in {frames}"
                )

    @property
    def _global_frames(self) -> Tuple[str, ...]:
        """Frames of the global and of the local costmap."""
        return tuple(self.parameters[name]["global_frame"].lstrip("/") for name in COSTMAPS)

    @property
    def global_frame(self) -> str:
        """Frame of the global costmap, of goals and of global plans."""
        return self._global_frames[0]

    def update_map(self, topic: str, x: int, y: int, cells: np.ndarray) -> None:
        """Write occupancies (h, w) int8 into a topic's map, first cell at (x, y).

        Raises:
            ApplrError: They leave the map.
        """
        for costmap in self.costmaps.values():
            costmap.update_map(topic, x, y, cells)
        # A reset shows the updated map again.
        if self.map_topics.get(topic):
            height, width = cells.shape
            self._maps[topic].cells[y : y + height, x : x + width] = cells

    # -- one step ----------------------------------------------------------------------------------
    def step(
        self,
        now: float,
        pose: Optional[Pose],
        twist: Twist,
        scan: Optional[Sensed] = None,
        local_origin: Optional[Pose] = None,
    ) -> Cycle:
        """Advance to time `now` [s]. Each component runs when it is due by its frequency.

        Args:
            now: time [s].
            pose: robot pose (x, y, yaw) in the local costmap's frame. None if this pose or
                `local_origin` is unknown. A global costmap in another frame then takes no
                observations.
            twist: driven velocity (v [m/s], w [rad/s]).
            scan: new observation on the first source's topic, or {topic: observation}. None if
                there is nothing new.
            local_origin: pose (x, y, yaw) of the local costmap's frame in the global one, None if
                they are the same.
        """
        cycle = Cycle()
        self.local_origin = local_origin

        # Observations come first, so that this step's maps and command know them.
        if scan is not None:
            global_frame, local_frame = self._global_frames
            is_placed = pose is not None or global_frame == local_frame
            self._router.route(scan, now, local_origin, is_placed)
        self._update_maps(now, pose, cycle)
        cycle.silent = self._router.silent(now)

        inputs = CycleInput(
            time=now,
            local_pose=pose,
            global_pose=None if pose is None else self.in_global_frame(pose),
            local_origin=local_origin,
            twist=twist,
            settings=self._config[""],
            scan_is_stale=cycle.silent is not None,
        )
        self._machine.step(inputs, cycle)
        return cycle

    def _update_maps(self, now: float, pose: Optional[Pose], cycle: Cycle) -> None:
        """Update the costmaps that are due."""
        is_shut_down = self.goal is None and self._config[""]["shutdown_costmaps"]
        if pose is None or is_shut_down:
            return
        local_is_due = self._timers["local_costmap"].due(now)
        global_is_due = self._timers["global_costmap"].due(now)
        if self.local_origin is not None:
            self._place_maps(self.local_origin)
        if local_is_due:
            self.local_costmap.update_costs(pose)
        if global_is_due:
            self.global_costmap.update_costs(self.in_global_frame(pose))
        cycle.updated = (local_is_due, global_is_due)

    def _place_maps(self, local_origin: Pose) -> None:
        """Set the placement of each static layer whose map is in the other costmap's frame."""
        global_frame, local_frame = self._global_frames
        for layer in self.global_costmap.static_layers:
            is_in_local = layer.map_frame == local_frame
            layer.placement = inverse(local_origin) if is_in_local else None
        for layer in self.local_costmap.static_layers:
            is_in_global = layer.map_frame == global_frame
            layer.placement = local_origin if is_in_global else None

    def in_global_frame(self, pose: Pose) -> Pose:
        """Transform a pose (x, y, yaw) from the local to the global costmap's frame.

        The frames are placed as in the last step.
        """
        if self.local_origin is None:
            return pose
        return compose(self.local_origin, pose)

    @property
    def sources(self) -> Dict[str, str]:
        """Data types of the observation sources by topic, those of the local costmap first."""
        return self._router.data_types

    @property
    def ray_origins(self) -> Dict[str, str]:
        """Frames at whose origins the rays start, by topic, for the sources that name one."""
        return self._router.ray_origins

    @property
    def goal(self) -> Optional[Pose]:
        """Current goal (x, y, yaw) in the global frame, or None."""
        return self._machine.goal

    @property
    def goal_number(self) -> int:
        """Number of goals since the last reset."""
        return self._machine.goal_number

    @property
    def global_plan(self) -> np.ndarray:
        """Latest global plan (n, 3): x, y [m], yaw [rad]."""
        return self._machine.global_plan

    @property
    def state(self) -> str:
        """State of the goal: "planning", "controlling" or "clearing"."""
        return self._machine.state

    # -- plans on request --------------------------------------------------------------------------
    def plan(self, start: Pose, goal: Pose, tolerance: Optional[float] = None) -> np.ndarray:
        """Return a navfn plan (n, 3) in the global frame, (0, 3) if there is none.

        Args:
            start: pose (x, y, yaw) of the robot.
            goal: pose (x, y, yaw) to reach.
            tolerance: distance [m] from the goal within which the plan may end, by default
                NavfnROS/default_tolerance.
        """
        settings = self.parameters["NavfnROS"]
        if tolerance is None:
            tolerance = settings["default_tolerance"]
        allow_unknown = settings["allow_unknown"]
        return self.navfn.plan(self.global_costmap, start[:2], goal, tolerance, allow_unknown)

    def make_plan(self, start: Pose, goal: Pose, tolerance: float = 0.0) -> np.ndarray:
        """Return a plan (n, 3) to the goal, or to a reachable point near it.

        This is the first one on growing squares around the goal. The plan is (0, 3) if nothing
        within `tolerance` [m] can be reached. While a goal is active, the node refuses the service
        and this method leaves the costmaps unchanged.
        """
        if not all(map(math.isfinite, (*start, *goal))):
            return NO_PLAN
        settings = self._config[""]
        if settings["make_plan_clear_costmap"] and self.goal is None:
            self._free_squares(start)
        plan = self.plan(start, goal)
        if len(plan) == 0 and tolerance > 0.0:
            append_goal = settings["make_plan_add_unreachable_goal"]
            plan = self._plan_near(start, goal, tolerance, append_goal)
        return plan

    def _free_squares(self, start: Pose) -> None:
        """Free a square around the start, a pose in the global frame, in both costmaps."""
        local_start = start
        if self.local_origin is not None:
            local_start = compose(inverse(self.local_origin), start)
        radius = self.parameters["clearing_radius"]
        free_square(self.global_costmap, start, radius)
        free_square(self.local_costmap, local_start, radius)

    def _plan_near(
        self, start: Pose, goal: Pose, tolerance: float, append_goal: bool
    ) -> np.ndarray:
        """Return a plan (n, 3) to the first reachable point near the goal that navfn finds."""
        allow_unknown = self.parameters["NavfnROS"]["allow_unknown"]
        points = reachable_near(self.global_costmap, start, goal, tolerance, allow_unknown)
        for x, y in points:
            plan = self.plan(start, (x, y, goal[2]))
            if len(plan) == 0:
                continue
            if append_goal:
                plan = np.vstack([plan, goal])
            return plan
        return NO_PLAN

    # -- parameters --------------------------------------------------------------------------------
    @property
    def servers(self) -> Dict[str, Server]:
        """dynamic_reconfigure servers by name. move_base's own server has the name ""."""
        return self._config.servers

    def configuration(self, server: str) -> Values:
        """Return the current values of a server ("", "TrajectoryPlannerROS", ...).

        Raises:
            ParameterError: there is no such server.
        """
        return self._config[server]

    @property
    def start_up(self) -> Settings:
        """Settings of all servers at start-up, as given by the parameter files."""
        return self._config.start_up

    def reconfigure(self, server: str, values: Values) -> Values:
        """Apply `values`, clamped to their bounds, and return the resulting values.

        As in C++, each call of a costmap's server clears the costmap, even with unchanged values,
        and makes its update due at once (Costmap2DROS::reconfigureCB). A costmap whose size comes
        from a static layer's map is not cleared. Calls of all other servers, those of the layers
        included, clear nothing.

        Raises:
            ParameterError: a value is invalid. All values are rejected.
        """
        old_values = self._config[server]
        new_values = self._config.result_of(server, values)
        changed_names = {name for name in new_values if new_values[name] != old_values[name]}
        # The planner may refuse, so it is asked before anything is changed.
        if server == self.local_planner_name:
            self.local_planner.reconfigure(new_values)
        self._config.accept(server, new_values)

        costmap_name, _, layer_name = server.partition("/")
        if server == "" and changed_names:
            self._take_frequencies()
        elif server in COSTMAPS:
            self._reconfigure_costmap(server, changed_names)
        elif costmap_name in COSTMAPS and changed_names:
            self.costmaps[costmap_name].configure(layer_name, **new_values)
        return new_values

    def put_in_force(self, settings: Settings) -> Settings:
        """Put settings in force, and return the resulting values of their servers.

        Like the applr node over ROS, it does not call servers that already have the values.

        Raises:
            ParameterError: as of `reconfigure`. Servers called before have their new values.
        """
        for server, values in settings.items():
            if not are_in_force(values, self.configuration(server)):
                self.reconfigure(server, values)
        # A server may clamp a value or change its older name, so that all its values are returned.
        return self._config.current.only(settings)

    def set_footprint(self, name: str, vertices: Iterable[Sequence[float]]) -> None:
        """Set the unpadded footprint (n, 2) [m] of a costmap, as received on its footprint topic.

        As in C++, it applies until `footprint` or `robot_radius` changes or the start-up parameters
        are restored.
        """
        self._outlines[name] = footprint.parse([list(map(float, point)) for point in vertices])
        self._show_footprint(name)

    def _show_footprint(self, name: str) -> None:
        """Apply a costmap's footprint: that of its topic, otherwise that of its parameters."""
        if name in self._outlines:
            outline = footprint.pad(self._outlines[name], self._config[name]["footprint_padding"])
        else:
            outline = footprint.padded(self._config[name])
        self.costmaps[name].set_footprint(outline)

    def _reconfigure_costmap(self, name: str, changed: Set[str]) -> None:
        """Apply changed values of a costmap's server: frequency, size and footprint."""
        values = self._config[name]
        self._timers[name] = Timer()  # C++ restarts the thread that updates the map.
        self._timers[name].set_frequency(values["update_frequency"])
        origin = (values["origin_x"], values["origin_y"])
        self.costmaps[name].resize(values["width"], values["height"], values["resolution"], origin)
        if changed & {"footprint", "robot_radius"}:
            self._outlines.pop(name, None)
        if changed & {"footprint", "robot_radius", "footprint_padding"}:
            self._show_footprint(name)
