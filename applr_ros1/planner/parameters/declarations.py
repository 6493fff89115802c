"""Every parameter of move_base, once: name, type, bounds, default, unit and a sentence.

The rows stand in move_base_parameters.py, trajectory_planner_parameters.py, dwa_planner_parameters.py and
costmap_parameters.py; here they are joined by dynamic_reconfigure server and name space. The .cfg files,
docs/reference/parameters.md, the parameter check at start-up and MoveBase follow from them. Pure standard library, for
the .cfg files import it at build time without numpy.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, Iterator, NamedTuple, Tuple

from applr_ros1.planner.parameters import costmap_parameters, dwa_planner_parameters, trajectory_planner_parameters
from applr_ros1.planner.parameters.costmap_parameters import (
    COSTMAP,
    INFLATION,
    OBSTACLES,
    STATIC_COSTMAP,
    STATIC_OBSTACLES,
    STATIC_SOURCE,
)
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER, STATIC_DWA_PLANNER
from applr_ros1.planner.parameters.layers import COSTMAPS, OBSTACLE_LAYER, TYPES, layers, sources
from applr_ros1.planner.parameters.move_base_parameters import (
    AGGRESSIVE_RESET,
    APPLR_NODE,
    CONSERVATIVE_RESET,
    MOVE_BASE,
    ROTATE_RECOVERY,
    STATIC_MOVE_BASE,
    STATIC_NAVFN,
)
from applr_ros1.planner.parameters.parameter import OUTLINE, Parameter
from applr_ros1.planner.parameters.trajectory_planner_parameters import STATIC_TRAJECTORY_PLANNER, TRAJECTORY_PLANNER

GLOBAL_PLANNERS = ("navfn/NavfnROS",)
LOCAL_PLANNERS = ("base_local_planner/TrajectoryPlannerROS", "dwa_local_planner/DWAPlannerROS")

SERVERS: Dict[str, Tuple[Parameter, ...]] = {
    "": MOVE_BASE,
    "TrajectoryPlannerROS": TRAJECTORY_PLANNER,
    "DWAPlannerROS": DWA_PLANNER,
    "global_costmap": COSTMAP,
    "global_costmap/inflater_layer": INFLATION,
    "global_costmap/obstacles_layer": OBSTACLES,
    "local_costmap": COSTMAP,
    "local_costmap/inflater_layer": INFLATION,
    "local_costmap/obstacles_layer": OBSTACLES,
}

STATIC: Dict[str, Tuple[Parameter, ...]] = {
    "": STATIC_MOVE_BASE,
    "TrajectoryPlannerROS": STATIC_TRAJECTORY_PLANNER,
    "DWAPlannerROS": STATIC_DWA_PLANNER,
    "NavfnROS": STATIC_NAVFN,
    "conservative_reset": CONSERVATIVE_RESET,
    "aggressive_reset": AGGRESSIVE_RESET,
    "applr": APPLR_NODE,
    "rotate_recovery": ROTATE_RECOVERY,
    "global_costmap": STATIC_COSTMAP,
    "global_costmap/obstacles_layer": STATIC_OBSTACLES,
    "global_costmap/obstacles_layer/scan": STATIC_SOURCE,
    "local_costmap": STATIC_COSTMAP,
    "local_costmap/obstacles_layer": STATIC_OBSTACLES,
    "local_costmap/obstacles_layer/scan": STATIC_SOURCE,
}

# by place: yields a line for each value, by its name there, that cannot be run together with the others
CONTRADICTIONS: Dict[str, Callable[[Dict[str, Any]], Iterator[str]]] = {
    "TrajectoryPlannerROS": trajectory_planner_parameters.contradictions,
    "DWAPlannerROS": dwa_planner_parameters.contradictions,
    **dict.fromkeys(COSTMAPS, costmap_parameters.contradictions),
}


def of_kind(kind: str) -> Tuple[str, ...]:
    """Return the names that local planners' parameters of a kind have, or had."""
    planners = ("TrajectoryPlannerROS", "DWAPlannerROS")
    declared = (p for planner in planners for p in SERVERS[planner] + STATIC[planner] if p.kind == kind)
    return tuple(dict.fromkeys(name for p in declared for name in (*p.names, *p.older)))


def shapes_at_start(planner: str, server: str, name: str) -> bool:
    """Return whether a local planner takes a live parameter into its every cycle as it was when move_base started.

    By reconfigure it then means something else than in a parameter file: of footprint_padding, the costmaps take the
    new value, and TrajectoryPlannerROS drives on with the outline of its start (trajectory_planner_ros.cpp:251).
    """
    once = {each: p.once for p in SERVERS.get(server, ()) for each in p.names}
    return server == "local_costmap" and planner == OUTLINE and OUTLINE in once.get(name, ())


class Server(NamedTuple):
    """A dynamic_reconfigure server: the name of its generated type, without "Config", and its parameters."""

    config: str
    parameters: Tuple[Parameter, ...]


def servers(tree: Dict[str, Any]) -> Dict[str, Server]:
    """The dynamic_reconfigure servers of a complete parameter tree: move_base, the local planner, costmaps, layers.

    Returns:
        {name: Server}; "" is move_base's own.
    """
    planner = namespace(tree["base_local_planner"])
    found = {"": Server("MoveBase", MOVE_BASE), planner: Server(planner[: -len("ROS")], SERVERS[planner])}
    for name in COSTMAPS:
        found[name] = Server("Costmap2D", SERVERS[name])
        for layer in layers(name, tree[name]):
            found[layer.path] = Server(TYPES[layer.kind].config, TYPES[layer.kind].live)
    return found


def tables(tree: Dict[str, Any]) -> Dict[str, Tuple[Parameter, ...]]:
    """All parameters by place, of a tree that is arranged (layers.arranged): the names that can be given."""
    places = [path for path in dict.fromkeys([*SERVERS, *STATIC]) if "costmap/" not in path]
    found = {path: SERVERS.get(path, ()) + STATIC.get(path, ()) for path in places}
    for name in COSTMAPS:
        costmap = tree.get(name, {})
        for layer in layers(name, costmap) if isinstance(costmap, dict) else ():
            found[layer.path] = TYPES[layer.kind].live + TYPES[layer.kind].static
            own = costmap.get(layer.name, {})
            if layer.kind == OBSTACLE_LAYER and isinstance(own, dict):
                found.update({f"{layer.path}/{source}": STATIC_SOURCE for source in sources(own)})
    return found


def namespace(plugin: str) -> str:
    """The name space of a plugin's parameters and topics: its name without the package."""
    return plugin.rpartition("/")[2]
