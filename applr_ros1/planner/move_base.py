"""The whole move_base without ROS, in steps: costmaps, planners, recoveries, parameters, requests.

The ROS node and the training environment step the same object. One thread, no clock and no randomness of its own:
calls get their time, resets their seed. What happens to a goal is state_machine.py.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Optional

import numpy as np

from applr_ros1.common.angles import compose, inverse
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
from applr_ros1.planner.state_machine import NO_PLAN, Components, Cycle, CycleInput, Pose, StateMachine, Timer, Twist
from applr_ros1.planner.variant import CPP_LIKE, OURS, draw, generator

INVALID_GOAL = "Aborting on goal because it was sent with an invalid quaternion"


class MoveBase:
    """`params`: a nested ROS parameter tree; what it leaves out has its default (planner/parameters).

    planner: see variant.py. seed: an int, or a sequence of them, that decides what is "drawn" until the first reset,
    and when a C++-like planner is late. Its attribute local_planner_name is the local planner's name space.

    Raises ParameterError or ApplrError (one line) for what cannot be run.
    """

    def __init__(self, params: Dict[str, Any], planner: str = OURS, seed=0):
        self.parameters = complete(params)
        self.local_planner_name = namespace(self.parameters["base_local_planner"])
        self._config = Configuration(self.parameters)
        self._planner = planner
        self._seed = seed
        self._maps: Dict[str, StaticMap] = {}
        self._outlines: Dict[str, np.ndarray] = {}  # unpadded (n, 2) [m], of costmaps that were given one by topic
        self._build()

    # -- the parts -------------------------------------------------------------------------------------------
    def _build(self) -> None:
        """Fresh maps, planners and state from the configuration in force."""
        self.global_costmap, self.local_costmap = (
            make_costmap(name, self.parameters[name], self._config) for name in COSTMAPS
        )
        self.variant = draw(self._planner, self._seed)  # what is in force
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
        self._machine = StateMachine(self._components, generator(self._seed, 3) if like_cpp else None)
        self._timers = {name: Timer() for name in COSTMAPS}
        self._take_frequencies()
        self._router = ObservationRouter(self.local_costmap, self.global_costmap, self.parameters["scan_timeout"])
        self.local_origin: Optional[Pose] = None  # of the last step
        for topic, given in self._maps.items():
            self._show_map(topic, given)
        for name in self._outlines:
            self._show_footprint(name)

    def _take_frequencies(self) -> None:
        settings = self._config[""]
        self._machine.set_frequencies(settings["planner_frequency"], settings["controller_frequency"])
        for name in COSTMAPS:
            self._timers[name].set_frequency(self._config[name]["update_frequency"])

    @property
    def frequency(self) -> float:
        """Rate at which step() wants to be called [Hz]: that of its fastest part."""
        settings = self._config[""]
        return max(
            [settings["controller_frequency"], settings["planner_frequency"]]
            + [self._config[name]["update_frequency"] for name in COSTMAPS]
        )

    @property
    def local_planner(self) -> LocalPlanner:
        """The local planner in use; another one may take its place."""
        return self._components.local_planner

    @local_planner.setter
    def local_planner(self, planner: LocalPlanner) -> None:
        self._components.local_planner = planner

    @property
    def goal_tolerance(self) -> float:
        """Distance from a goal [m] within which the local planner takes the goal's place for reached."""
        name = self.local_planner_name
        return {**self.parameters[name], **self._config[name]}["xy_goal_tolerance"]

    # -- requests between steps ------------------------------------------------------------------------------
    def set_goal(self, goal: Pose, now: float) -> None:
        """A goal (x, y, yaw) in the global frame; replaces the present one.

        Its end shows in a Cycle's result. One that is not finite ends as aborted at the next step.
        """
        x, y, yaw = (float(v) for v in goal)
        if not all(math.isfinite(v) for v in (x, y, yaw)):
            self.refuse_goal(INVALID_GOAL)
        else:
            self._machine.set_goal((x, y, yaw), now)

    def refuse_goal(self, text: str) -> None:
        """End as aborted, with `text`, at the next step: for a goal that cannot be used."""
        self._machine.refuse_goal(text)

    def cancel(self, now: float) -> None:
        """Give up the goal at the next step, whatever is under way."""
        self._machine.cancel()

    def report_held(self, held: bool) -> None:
        """Note if a collision monitor let next to nothing of the last command through (Verdict.blocked)."""
        self._machine.report_held(held)

    def reset(self, now: float, restore: bool = True, seed=None) -> None:
        """As a new object: empty maps, no goal, no memory. `restore`: also the start-up parameters.

        seed (an int, or a sequence of them): draws anew what is "drawn"; None: it stays as it was drawn.
        """
        self._seed = self._seed if seed is None else seed
        if restore:
            self._config.restore()
            self._outlines.clear()
        self._build()

    def clear_costmaps(self) -> None:
        """Empty both maps, local first; the last scan marks again at the next update."""
        self.local_costmap.clear()
        self.global_costmap.clear()

    # -- maps ------------------------------------------------------------------------------------------------
    @property
    def costmaps(self) -> Dict[str, Costmap]:
        """Both costmaps by name."""
        return {"global_costmap": self.global_costmap, "local_costmap": self.local_costmap}

    @property
    def map_topics(self) -> Dict[str, bool]:
        """{topic: whether a static layer takes updates of that map, too} of the maps that static layers want."""
        wanted: Dict[str, bool] = {}
        for costmap in self.costmaps.values():
            for layer in costmap.static_layers:
                p = layer.parameters
                wanted[p.map_topic] = wanted.get(p.map_topic, False) or p.subscribe_to_updates
        return wanted

    @property
    def missing_map(self) -> str:
        """The topic of a map that a static layer still waits for, or ""."""
        layers = [layer for costmap in self.costmaps.values() for layer in costmap.static_layers]
        return next((layer.parameters.map_topic for layer in layers if layer.is_waiting), "")

    def set_map(self, given: StaticMap, topic: str = "") -> None:
        """A map for the static layers that listen to `topic`, or to the first of map_topics. It outlasts a reset.

        ApplrError for one that cannot be used: nothing has changed.
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

    def _show_map(self, topic, given) -> None:
        for costmap in self.costmaps.values():
            costmap.set_map(topic, given)

    def _check_frame(self, topic, given) -> None:
        for name, costmap in self.costmaps.items():
            listens = any(layer.parameters.map_topic == topic for layer in costmap.static_layers)
            if listens and costmap.rolling and given.frame not in ("", *self._global_frames):
                raise ApplrError(
                    f"the map on {topic} is in frame {given.frame}: {name} rolls and can show one in "
                    f"{' or '.join(self._global_frames)} alone"
                )

    @property
    def _global_frames(self):
        """The frames of the global and of the local costmap."""
        return tuple(self.parameters[name]["global_frame"].lstrip("/") for name in COSTMAPS)

    def update_map(self, topic: str, x: int, y: int, cells: np.ndarray) -> None:
        """Occupancies (h, w) int8 that changed in the map of a topic. ApplrError where they are not on it."""
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
        """One turn at time `now` [s]. Components run when their frequency says so.

        Args:
            now: time [s].
            pose: (x, y, yaw) of the robot in the local costmap's frame, or None if it is not known, or if
                `local_origin` is not: then the global costmap of another frame takes no observation.
            twist: (v, w) as driven.
            scan: what is new from the first source's topic, or {topic: observation}; None if nothing is.
            local_origin: pose (x, y, yaw) of the local costmap's frame in the global one's, as localisation has it;
                None where the two are one.
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
        self._machine.step(CycleInput(now, pose, global_pose, local_origin, twist, settings, stale), cycle)
        return cycle

    def _update_maps(self, now, pose, cycle) -> None:
        if pose is None or self.goal is None and self._config[""]["shutdown_costmaps"]:
            return
        local, world = self._timers["local_costmap"].due(now), self._timers["global_costmap"].due(now)
        if self.local_origin is not None:
            self._place_maps()
        if local:
            self.local_costmap.update(pose)
        if world:
            self.global_costmap.update(self.in_global_frame(pose))
        cycle.updated = local, world

    def _place_maps(self) -> None:
        """Tell the static layers where their costmap lies in a map of the other costmap's frame."""
        world, local = self._global_frames
        local_origin = self.local_origin or (0.0, 0.0, 0.0)
        placements = (self.global_costmap, local, inverse(local_origin)), (self.local_costmap, world, local_origin)
        for costmap, other, placement in placements:
            for layer in costmap.static_layers:
                layer.placement = placement if layer.map_frame == other else None

    def in_global_frame(self, pose: Pose) -> Pose:
        """A pose (x, y, yaw) of the local costmap's frame in the global costmap's, as the last step had them."""
        return pose if self.local_origin is None else compose(self.local_origin, pose)

    @property
    def sources(self) -> Dict[str, str]:
        """{topic: data type} of the observation sources, those of the local costmap first."""
        return self._router.data_types

    @property
    def ray_origins(self) -> Dict[str, str]:
        """{topic: frame at whose origin the rays start} of the sources that give one."""
        return self._router.ray_origins

    @property
    def goal(self) -> Optional[Pose]:
        """The goal (x, y, yaw) under way in the global frame, or None."""
        return self._machine.goal

    @property
    def goal_number(self) -> int:
        """Number of goals since the last reset."""
        return self._machine.goal_number

    @property
    def global_plan(self) -> np.ndarray:
        """(n, 3) x, y [m], yaw [rad]: the newest plan that was found."""
        return self._machine.global_plan

    @property
    def state(self) -> str:
        """One of the words "planning", "controlling" and "clearing"."""
        return self._machine.state

    # -- plans on request ------------------------------------------------------------------------------------
    def plan(self, start: Pose, goal: Pose, tolerance: Optional[float] = None) -> np.ndarray:
        """A navfn plan (n, 3) from start to goal (x, y, yaw) in the global frame, (0, 3) if none (NavfnROS)."""
        settings = self.parameters["NavfnROS"]
        tolerance = settings["default_tolerance"] if tolerance is None else tolerance
        return self.navfn.plan(self.global_costmap, start[:2], goal, tolerance, settings["allow_unknown"])

    def make_plan(self, start: Pose, goal: Pose, tolerance: float = 0.0) -> np.ndarray:
        """move_base's make_plan: to the goal, else to the first free point of growing squares about it.

        (n, 3); (0, 3) if nothing within `tolerance` [m] can be reached. While a goal is active the node
        refuses the service, and this leaves the maps as they are.
        """
        if not all(math.isfinite(v) for v in tuple(start) + tuple(goal)):
            return NO_PLAN
        settings = self._config[""]
        if settings["make_plan_clear_costmap"] and self.goal is None:
            here = start if self.local_origin is None else compose(inverse(self.local_origin), start)
            for costmap, pose in ((self.global_costmap, start), (self.local_costmap, here)):
                free_square(costmap, pose, self.parameters["clearing_radius"])
        plan = self.plan(start, goal)
        if not len(plan) and tolerance > 0.0:
            plan = self._plan_near(start, goal, tolerance, settings["make_plan_add_unreachable_goal"])
        return plan

    def _plan_near(self, start, goal, tolerance, append_goal) -> np.ndarray:
        unknown = self.parameters["NavfnROS"]["allow_unknown"]
        for x, y in reachable_near(self.global_costmap, start, goal, tolerance, unknown):
            plan = self.plan(start, (x, y, goal[2]))
            if len(plan):
                return np.vstack([plan, goal]) if append_goal else plan
        return NO_PLAN

    # -- parameters ------------------------------------------------------------------------------------------
    @property
    def servers(self) -> Dict[str, Server]:
        """The dynamic_reconfigure servers by name, "" for move_base's own."""
        return servers(self.parameters)

    def configuration(self, server: str) -> Dict[str, Any]:
        """The values in force of one server ("", "TrajectoryPlannerROS", "local_costmap", ...), not to be changed."""
        return self._config[server]

    def reconfigure(self, server: str, values: Dict[str, Any]) -> Dict[str, Any]:
        """Take `values` (out of bounds: clamped), return what is in force. ParameterError refuses them whole.

        As in C++, every call of a costmap's server, unchanged values or not, empties that map, unless a static layer's
        map decides its size, and makes its update due at once (Costmap2DROS::reconfigureCB). Calls of the layers'
        servers and of the others leave both maps as they are.
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
        """The values one server started with: theta_0 where the parameter files gave it."""
        return self._config.start_up(server)

    def set_footprint(self, name: str, vertices) -> None:
        """An unpadded outline (n, 2) [m] for one costmap, as its footprint topic gives it.

        It holds until `footprint` or `robot_radius` is changed, as in C++, or until the start-up parameters are
        restored.
        """
        self._outlines[name] = footprint.parse([list(map(float, point)) for point in vertices])
        self._show_footprint(name)

    def _show_footprint(self, name: str) -> None:
        """Has a costmap use its outline: the one given by topic, else that of its parameters."""
        if name in self._outlines:
            outline = footprint.pad(self._outlines[name], self._config[name]["footprint_padding"])
        else:
            outline = footprint.padded(self._config[name])
        self.costmaps[name].set_footprint(outline)

    def _reconfigure_costmap(self, name, changed) -> None:
        now = self._config[name]
        self._timers[name] = Timer()  # C++ ends the thread of the map's updates and starts another
        self._timers[name].set_frequency(now["update_frequency"])
        self.costmaps[name].resize(now["width"], now["height"], now["resolution"], (now["origin_x"], now["origin_y"]))
        if changed & {"footprint", "robot_radius"}:
            self._outlines.pop(name, None)
        if changed & {"footprint", "robot_radius", "footprint_padding"}:
            self._show_footprint(name)
