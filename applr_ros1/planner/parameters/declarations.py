"""Declarations of all parameters of move_base: name, type, bounds, default, unit and description.

The rows are in move_base_parameters.py, trajectory_planner_parameters.py, dwa_planner_parameters.py
and costmap_parameters.py. Here they are combined by dynamic_reconfigure server and name space, for
the .cfg files, docs/reference/parameters.md, the parameter check at start-up and MoveBase. This
file uses only the standard library because the .cfg files import it at build time, without numpy.
"""

from __future__ import annotations

from typing import Callable, Dict, Iterator, NamedTuple, Optional, Tuple

from applr_ros1.planner.parameters import (
    costmap_parameters,
    dwa_planner_parameters,
    trajectory_planner_parameters,
)
from applr_ros1.planner.parameters.costmap_parameters import (
    COSTMAP,
    INFLATION,
    OBSTACLES,
    STATIC_COSTMAP,
    STATIC_OBSTACLES,
    STATIC_SOURCE,
)
from applr_ros1.planner.parameters.dwa_planner_parameters import DWA_PLANNER, STATIC_DWA_PLANNER
from applr_ros1.planner.parameters.layers import COSTMAPS, TYPES, layers
from applr_ros1.planner.parameters.move_base_parameters import (
    AGGRESSIVE_RESET,
    APPLR_NODE,
    CONSERVATIVE_RESET,
    MOVE_BASE,
    ROTATE_RECOVERY,
    STATIC_MOVE_BASE,
    STATIC_NAVFN,
)
from applr_ros1.planner.parameters.parameter import OUTLINE, Parameter, by_name
from applr_ros1.planner.parameters.trajectory_planner_parameters import (
    STATIC_TRAJECTORY_PLANNER,
    TRAJECTORY_PLANNER,
)
from applr_ros1.planner.parameters.trees import Tree

GLOBAL_PLANNERS = ("navfn/NavfnROS",)
LOCAL_PLANNERS = ("base_local_planner/TrajectoryPlannerROS", "dwa_local_planner/DWAPlannerROS")

# Parameters that a reconfigure changes, by server, and below them the parameters that are read
# once, by section. The layers are those of the Jackal's files.
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

# Per section, a function that yields a message for each value that conflicts with another value of
# the section.
CONTRADICTIONS: Dict[str, Callable[[Tree], Iterator[str]]] = {
    "TrajectoryPlannerROS": trajectory_planner_parameters.contradictions,
    "DWAPlannerROS": dwa_planner_parameters.contradictions,
    **dict.fromkeys(COSTMAPS, costmap_parameters.contradictions),
}


def of_kind(kind: str) -> Tuple[str, ...]:
    """Return the names of the local planners' parameters of a kind (Parameter.kind).

    Older names are included. Each name occurs once.
    """
    names: Dict[str, None] = {}  # a set that keeps the order
    for planner in ("TrajectoryPlannerROS", "DWAPlannerROS"):
        for parameter in SERVERS[planner] + STATIC[planner]:
            if parameter.kind == kind:
                names.update(dict.fromkeys((*parameter.names, *parameter.older)))
    return tuple(names)


def shapes_at_start(planner: str, server: str, name: str) -> bool:
    """Return whether a local planner keeps the start-up value of a live parameter.

    A reconfigure of this parameter has another effect than a new value in a parameter file. For
    example, the costmaps take a new footprint_padding, but TrajectoryPlannerROS keeps its first
    footprint (trajectory_planner_ros.cpp:251).
    """
    # Of the values that a local planner keeps, only those of its costmap have a server elsewhere.
    if server != "local_costmap" or planner != OUTLINE:
        return False
    return any(
        name in parameter.names and OUTLINE in parameter.once for parameter in SERVERS[server]
    )


class Server(NamedTuple):
    """Dynamic_reconfigure server.

    Attributes:
        config: Name of its generated type, without "Config".
        parameters: Its parameters.
    """

    config: str
    parameters: Tuple[Parameter, ...]

    def declared(self, name: str) -> Optional[Parameter]:
        """Return the declaration of a parameter by its name or an alias; None if there is none."""
        return by_name(self.parameters).get(name)


def servers(tree: Tree) -> Dict[str, Server]:
    """Return the dynamic_reconfigure servers of a complete parameter tree.

    These are move_base, the local planner, the costmaps and their layers.

    Returns:
        {name: Server}; the name of move_base's own server is "".
    """
    planner = namespace(tree["base_local_planner"])
    declared_servers = {
        "": Server("MoveBase", MOVE_BASE),
        planner: Server(planner[: -len("ROS")], SERVERS[planner]),
    }
    for costmap_name in COSTMAPS:
        declared_servers[costmap_name] = Server("Costmap2D", SERVERS[costmap_name])
        for layer in layers(costmap_name, tree[costmap_name]):
            layer_type = TYPES[layer.kind]
            declared_servers[layer.path] = Server(layer_type.config, layer_type.live)
    return declared_servers


def tables(tree: Tree) -> Dict[str, Tuple[Parameter, ...]]:
    """Return the parameters of each section of an arranged tree (layers.arranged)."""
    # SERVERS and STATIC have the layers of the Jackal; a tree may have others.
    declared_sections = {}
    for path in dict.fromkeys([*SERVERS, *STATIC]):
        if "costmap/" not in path:
            declared_sections[path] = SERVERS.get(path, ()) + STATIC.get(path, ())
    for costmap_name in COSTMAPS:
        costmap = tree.get(costmap_name, {})
        if not isinstance(costmap, dict):
            continue
        for layer in layers(costmap_name, costmap):
            layer_type = TYPES[layer.kind]
            declared_sections[layer.path] = layer_type.live + layer_type.static
            for source in layer.sources:
                declared_sections[f"{layer.path}/{source}"] = STATIC_SOURCE
    return declared_sections


def namespace(plugin: str) -> str:
    """Return the name space of a plugin's parameters and topics, its name without the package."""
    return plugin.rpartition("/")[2]
