"""move_base without ROS, advanced in steps: costmaps, planners, recoveries, parameters and requests.

The ROS node and the training environment step the same class. It runs in one thread and has neither a clock nor a
random source: time and seed are arguments. state_machine.py handles the goals.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterable, Optional, Sequence, Set, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, compose, inverse
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner import recovery
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.static_layer import StaticMap
from applr_ros1.planner.factory import make_costmap, make_local_planner
from applr_ros1.planner.local_planner import LocalPlanner
from applr_ros1.planner.make_plan import free_square, reachable_near
from applr_ros1.planner.navfn.navfn import Navfn
from applr_ros1.planner.observation_router import ObservationRouter, Sensed
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.configuration import Configuration
from applr_ros1.planner.parameters.declarations import Server, namespace, servers
from applr_ros1.planner.parameters.layers import COSTMAPS
from applr_ros1.planner.state_machine import (
    NO_PLAN,
    Components,
    Cycle,
    CycleInput,
    StateMachine,
    Timer,
    Twist,
)
from applr_ros1.planner.variant import CPP_LIKE, OURS, draw, generator

INVALID_GOAL = "Aborting on goal because it was sent with an invalid quaternion"


class MoveBase:
    """Complete move_base, advanced by `step`.

    Args:
        params: nested ROS parameter tree. Missing parameters have their defaults (planner/parameters).
        planner: planner fidelity, see variant.py.
        seed: int or sequence of ints, used until `reset` gives another one. With "drawn", the seed determines the
            planner fidelity, and with "cpp-like", the cycles whose plan comes late (state_machine.LATE).

    Attributes:
        local_planner_name: namespace of the local planner.

    Raises:
        ParameterError, ApplrError: the parameters cannot be used. The message has one line.
    """

    def __init__(
        self, params: Dict[str, Any], planner: str = OURS, seed: Union[int, Sequence[int]] = 0
    ):
        self.parameters = complete(params)
        self.local_planner_name = namespace(self.parameters["base_local_planner"])
        self._config = Configuration(self.parameters)
        self._planner = planner
        self._seed = seed
        self._maps: Dict[str, StaticMap] = {}
        self._outlines: Dict[
            str, np.ndarray
        ] = {}  # by costmap: unpadded footprint (n, 2) [m] from its topic
        self._build()

    # -- components ------------------------------------------------------------------------------------------
    def _build(self) -> None:
        """Create costmaps, planners and state from the current configuration."""
        self.global_costmap, self.local_costmap = (
            make_costmap(name, self.parameters[name], self._config) for name in COSTMAPS
        )
        self.variant = draw(self._planner, self._seed)  # current planner fidelity
        like_cpp = self.variant == CPP_LIKE
        local_planner = make_local_planner(self.parameters, self._config)
        self.navfn = Navfn()
        self.recoveries = recovery.build(self.parameters, like_cpp)
        self._components = Components(
            local_planner,
            self.local_costmap,
            self.global_costmap,
            self.recoveries,
            self.plan,
            self.parameters["applr"]["recovery_rounds"],
        )
        self._machine = StateMachine(
            self._components, generator(self._seed, 3) if like_cpp else None
        )
        self._timers = {name: Timer() for name in COSTMAPS}
        self._take_frequencies()
        self._router = ObservationRouter(
            self.local_costmap, self.global_costmap, self.parameters["scan_timeout"]
        )
        self.local_origin: Optional[Pose] = (
            None  # pose of the local costmap's frame in the global one (last step)
        )
        for topic, given in self._maps.items():
            self._show_map(topic, given)
        for name in self._outlines:
            self._show_footprint(name)

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
        updates = [self._config[name]["update_frequency"] for name in COSTMAPS]
        return float(max(settings["controller_frequency"], settings["planner_frequency"], *updates))

    @property
    def local_planner(self) -> LocalPlanner:
        """Local planner in use. It can be replaced."""
        return self._components.local_planner

    @local_planner.setter
    def local_planner(self, planner: LocalPlanner) -> None:
        self._components.local_planner = planner

    @property
    def goal_tolerance(self) -> float:
        """Distance to the goal within which the position counts as reached for the local planner [m]."""
        name = self.local_planner_name
        return float({**self.parameters[name], **self._config[name]}["xy_goal_tolerance"])

    # -- requests between steps ------------------------------------------------------------------------------
    def set_goal(self, goal: Pose, now: float) -> None:
        """Set the goal (x, y, yaw) in the global frame, which replaces the current one.

        The result appears in a later Cycle. A goal that is not finite is aborted at the next step.
        """
        x, y, yaw = (float(v) for v in goal)
        if not all(math.isfinite(v) for v in (x, y, yaw)):
            self.refuse_goal(INVALID_GOAL)
        else:
            self._machine.set_goal((x, y, yaw), now)

    def refuse_goal(self, text: str) -> None:
        """Abort with `text` at the next step, because the goal cannot be used."""
        self._machine.refuse_goal(text)

    def cancel(self, now: float) -> None:
        """Cancel the goal at the next step, in any state."""
        self._machine.cancel()

    def report_held(self, held: bool) -> None:
        """Record whether a collision monitor blocked nearly all of the last command (Verdict.blocked)."""
        self._machine.report_held(held)

    def reset(
        self, now: float, restore: bool = True, seed: Union[int, Sequence[int], None] = None
    ) -> None:
        """Reset to the state of a new object: empty maps, no goal, no memory.

        Args:
            now: time [s].
            restore: whether to restore the start-up parameters, too.
            seed: new seed (see the class). None keeps the last seed, and thus the planner fidelity.
        """
        self._seed = self._seed if seed is None else seed
        if restore:
            self._config.restore()
            self._outlines.clear()
        self._build()

    def clear_costmaps(self) -> None:
        """Clear both costmaps, the local one first. The last scan marks again at the next update."""
        self.local_costmap.clear()
        self.global_costmap.clear()

    # -- maps ------------------------------------------------------------------------------------------------
    @property
    def costmaps(self) -> Dict[str, Costmap]:
        """Both costmaps by name."""
        return {"global_costmap": self.global_costmap, "local_costmap": self.local_costmap}

    @property
    def map_topics(self) -> Dict[str, bool]:
        """Topics of the maps that static layers need: {topic: whether a static layer takes updates, too}."""
        wanted: Dict[str, bool] = {}
        for costmap in self.costmaps.values():
            for layer in costmap.static_layers:
                p = layer.parameters
                wanted[p.map_topic] = wanted.get(p.map_topic, False) or p.subscribe_to_updates
        return wanted

    @property
    def missing_map(self) -> str:
        """Topic of a map that a static layer still waits for, or "" if there is none."""
        layers = [layer for costmap in self.costmaps.values() for layer in costmap.static_layers]
        return next((layer.parameters.map_topic for layer in layers if layer.is_waiting), "")

    def set_map(self, given: StaticMap, topic: str = "") -> None:
        """Set the map of static layers that listen to `topic` (default: first of map_topics). A reset keeps the map.

        Raises:
            ApplrError: the map cannot be used. Nothing is changed.
        """
        topic = topic or next(iter(self.map_topics), "")
        given = given.checked()
        self._check_frame(topic, given)
        if topic not in self._maps or any(
            layer.parameters.map_topic == topic and layer.accepts()
            for costmap in self.costmaps.values()
            for layer in costmap.static_layers
        ):
            self._maps[topic] = given
        self._show_map(topic, given)

    def _show_map(self, topic: str, given: StaticMap) -> None:
        for costmap in self.costmaps.values():
            costmap.set_map(topic, given)

    def _check_frame(self, topic: str, given: StaticMap) -> None:
        for name, costmap in self.costmaps.items():
            listens = any(layer.parameters.map_topic == topic for layer in costmap.static_layers)
            if listens and costmap.rolling and given.frame not in ("", *self._global_frames):
                raise ApplrError(
                    f"the map on {topic} is in frame {given.frame}, which the rolling {name} cannot use: publish it in "
                    f"{' or '.join(self._global_frames)}"
                )

    @property
    def _global_frames(self) -> Tuple[str, ...]:
        """Frames of the global and of the local costmap."""
        return tuple(self.parameters[name]["global_frame"].lstrip("/") for name in COSTMAPS)

    def update_map(self, topic: str, x: int, y: int, cells: np.ndarray) -> None:
        """Write occupancies (h, w) int8 into a topic's map, first cell at (x, y). Raise ApplrError if they leave it."""
        for costmap in self.costmaps.values():
            costmap.update_map(topic, x, y, cells)
        if self.map_topics.get(topic):
            self._maps[topic].cells[y : y + cells.shape[0], x : x + cells.shape[1]] = cells

    # -- one step --------------------------------------------------------------------------------------------
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
            pose: robot pose (x, y, yaw) in the local costmap's frame. None if this pose or `local_origin` is unknown. A
                global costmap in another frame then takes no observations.
            twist: driven velocity (v [m/s], w [rad/s]).
            scan: new observation on the first source's topic, or {topic: observation}. None if there is nothing new.
            local_origin: pose (x, y, yaw) of the local costmap's frame in the global one, None if they are the same.
        """
        cycle = Cycle()
        self.local_origin = local_origin
        if scan is not None:
            world, local = self._global_frames
            self._router.take(scan, now, local_origin, placed=pose is not None or world == local)
        self._update_maps(now, pose, cycle)
        cycle.silent = self._router.silent(now)
        global_pose = None if pose is None else self.in_global_frame(pose)
        settings, stale = self._config[""], cycle.silent is not None
        self._machine.step(
            CycleInput(now, pose, global_pose, local_origin, twist, settings, stale), cycle
        )
        return cycle

    def _update_maps(self, now: float, pose: Optional[Pose], cycle: Cycle) -> None:
        if pose is None or self.goal is None and self._config[""]["shutdown_costmaps"]:
            return
        local, world = (
            self._timers["local_costmap"].due(now),
            self._timers["global_costmap"].due(now),
        )
        if self.local_origin is not None:
            self._place_maps()
        if local:
            self.local_costmap.update(pose)
        if world:
            self.global_costmap.update(self.in_global_frame(pose))
        cycle.updated = local, world

    def _place_maps(self) -> None:
        """Set the placement of each static layer whose map is in the frame of the other costmap."""
        world, local = self._global_frames
        local_origin = self.local_origin or (0.0, 0.0, 0.0)
        placements = (
            (self.global_costmap, local, inverse(local_origin)),
            (self.local_costmap, world, local_origin),
        )
        for costmap, other, placement in placements:
            for layer in costmap.static_layers:
                layer.placement = placement if layer.map_frame == other else None

    def in_global_frame(self, pose: Pose) -> Pose:
        """Transform a pose (x, y, yaw) from the local to the global costmap's frame, as of the last step."""
        return pose if self.local_origin is None else compose(self.local_origin, pose)

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

    # -- plans on request ------------------------------------------------------------------------------------
    def plan(self, start: Pose, goal: Pose, tolerance: Optional[float] = None) -> np.ndarray:
        """Return a navfn plan (n, 3) from start to goal (x, y, yaw) in the global frame, or (0, 3) if there is none."""
        settings = self.parameters["NavfnROS"]
        tolerance = settings["default_tolerance"] if tolerance is None else tolerance
        return self.navfn.plan(
            self.global_costmap, start[:2], goal, tolerance, settings["allow_unknown"]
        )

    def make_plan(self, start: Pose, goal: Pose, tolerance: float = 0.0) -> np.ndarray:
        """Return a plan (n, 3) to the goal, or to the first reachable point on growing squares around the goal.

        The plan is (0, 3) if nothing within `tolerance` [m] can be reached. While a goal is active, the node refuses
        the service and this method leaves the costmaps unchanged.
        """
        if not all(math.isfinite(v) for v in tuple(start) + tuple(goal)):
            return NO_PLAN
        settings = self._config[""]
        if settings["make_plan_clear_costmap"] and self.goal is None:
            here = (
                start if self.local_origin is None else compose(inverse(self.local_origin), start)
            )
            for costmap, pose in ((self.global_costmap, start), (self.local_costmap, here)):
                free_square(costmap, pose, self.parameters["clearing_radius"])
        plan = self.plan(start, goal)
        if not len(plan) and tolerance > 0.0:
            plan = self._plan_near(
                start, goal, tolerance, settings["make_plan_add_unreachable_goal"]
            )
        return plan

    def _plan_near(
        self, start: Pose, goal: Pose, tolerance: float, append_goal: bool
    ) -> np.ndarray:
        unknown = self.parameters["NavfnROS"]["allow_unknown"]
        for x, y in reachable_near(self.global_costmap, start, goal, tolerance, unknown):
            plan = self.plan(start, (x, y, goal[2]))
            if len(plan):
                return np.vstack([plan, goal]) if append_goal else plan
        return NO_PLAN

    # -- parameters ------------------------------------------------------------------------------------------
    @property
    def servers(self) -> Dict[str, Server]:
        """dynamic_reconfigure servers by name. move_base's own server has the name ""."""
        return servers(self.parameters)

    def configuration(self, server: str) -> Dict[str, Any]:
        """Return the current values of a server ("", "TrajectoryPlannerROS", ...). The caller must not modify them."""
        return self._config[server]

    def reconfigure(self, server: str, values: Dict[str, Any]) -> Dict[str, Any]:
        """Apply `values`, clamped to their bounds, and return the resulting values.

        As in C++, each call of a costmap's server clears the costmap, even with unchanged values, and makes its update
        due at once (Costmap2DROS::reconfigureCB). A costmap whose size comes from a static layer's map is not cleared.
        Calls of all other servers, those of the layers included, clear nothing.

        Raises:
            ParameterError: a value is invalid. All values are rejected.
        """
        new, old = self._config.request(server, values), self._config[server]
        changed = {name for name in new if new[name] != old[name]}
        if server == self.local_planner_name:
            self.local_planner.reconfigure(new)
        self._config.accept(server, new)
        if server == "" and changed:
            self._take_frequencies()
        elif server in COSTMAPS:
            self._reconfigure_costmap(server, changed)
        elif server.partition("/")[0] in COSTMAPS and changed:
            name, _, layer = server.partition("/")
            self.costmaps[name].configure(layer, **new)
        return dict(new)

    def start_up_configuration(self, server: str) -> Dict[str, Any]:
        """Return the start-up values of a server, as set by the parameter files."""
        return self._config.start_up(server)

    def set_footprint(self, name: str, vertices: Iterable[Sequence[float]]) -> None:
        """Set the unpadded footprint (n, 2) [m] of a costmap, as received on its footprint topic.

        As in C++, it applies until `footprint` or `robot_radius` changes or the start-up parameters are restored.
        """
        self._outlines[name] = footprint.parse([list(map(float, point)) for point in vertices])
        self._show_footprint(name)

    def _show_footprint(self, name: str) -> None:
        """Apply a costmap's footprint: the one received by topic, otherwise the one in its parameters."""
        if name in self._outlines:
            outline = footprint.pad(self._outlines[name], self._config[name]["footprint_padding"])
        else:
            outline = footprint.padded(self._config[name])
        self.costmaps[name].set_footprint(outline)

    def _reconfigure_costmap(self, name: str, changed: Set[str]) -> None:
        now = self._config[name]
        self._timers[name] = Timer()  # C++ restarts the thread that updates the map.
        self._timers[name].set_frequency(now["update_frequency"])
        self.costmaps[name].resize(
            now["width"], now["height"], now["resolution"], (now["origin_x"], now["origin_y"])
        )
        if changed & {"footprint", "robot_radius"}:
            self._outlines.pop(name, None)
        if changed & {"footprint", "robot_radius", "footprint_padding"}:
            self._show_footprint(name)
