"""Layers of a costmap and the sections of their parameters, by the rules of costmap_2d_ros.cpp.

Used by the check and completion of parameter trees and by declarations.servers. Uses only the standard library.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, NamedTuple, Sequence, Tuple

from applr_ros1.common.trees import branch
from applr_ros1.planner.parameters.costmap_parameters import (
    INFLATION,
    OBSTACLES,
    STATIC_MAP,
    STATIC_OBSTACLES,
    STATIC_STATIC_MAP,
)
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError

COSTMAPS = ("global_costmap", "local_costmap")


class LayerType(NamedTuple):
    """Type of a layer.

    Attributes:
        config: name of the layer's dynamic_reconfigure type.
        live: parameters of the layer's dynamic_reconfigure server.
        static: parameters that are read once.
        inherited: names of parameters that replace the layer's own value if they are given at the costmap.
    """

    config: str
    live: Tuple[Parameter, ...]
    static: Tuple[Parameter, ...]
    inherited: Tuple[str, ...]


STATIC_LAYER, OBSTACLE_LAYER, INFLATION_LAYER = (
    f"costmap_2d::{kind}Layer" for kind in ("Static", "Obstacle", "Inflation")
)
TYPES: Dict[str, LayerType] = {
    STATIC_LAYER: LayerType(
        "GenericPlugin",
        STATIC_MAP,
        STATIC_STATIC_MAP,
        ("map_topic", "unknown_cost_value", "lethal_cost_threshold", "track_unknown_space"),
    ),
    OBSTACLE_LAYER: LayerType(
        "ObstaclePlugin",
        OBSTACLES,
        STATIC_OBSTACLES,
        ("max_obstacle_height", "raytrace_range", "obstacle_range", "track_unknown_space"),
    ),
    INFLATION_LAYER: LayerType(
        "InflationPlugin", INFLATION, (), ("cost_scaling_factor", "inflation_radius")
    ),
}
INHERITED: Dict[str, Parameter] = {
    p.name: p
    for kind in TYPES.values()
    for p in kind.live + kind.static
    if p.name in kind.inherited
}
VOXEL_LAYER = "costmap_2d::VoxelLayer"
PREDICTED = "applr/predicted"  # topic of the predicted obstacle points
# Costmap parameters that may also be given at move_base itself
FOUND_ABOVE = ("footprint", "robot_radius", "obstacle_range", "raytrace_range")
# Layers (name, type) of a costmap without `plugins`. The static layer requires static_map.
BEFORE_HYDRO = (
    ("static_layer", STATIC_LAYER),
    ("obstacle_layer", OBSTACLE_LAYER),
    ("inflation_layer", INFLATION_LAYER),
)


class Layer(NamedTuple):
    """Layer of a costmap."""

    path: str  # section in the parameter tree, such as "local_costmap/obstacle_layer"
    name: str
    kind: str  # one of TYPES


def layers(name: str, costmap: Dict[str, Any]) -> List[Layer]:
    """Return the layers of the costmap `name`, lowest first, without layers whose type is not available.

    Raises:
        ParameterError: `plugins` is not a list of names and types, or a name occurs twice.
    """
    declared: List[Layer] = []
    plugins = costmap.get("plugins", [])
    for entry in plugins if isinstance(plugins, list) else [plugins]:
        good = isinstance(plugins, list) and isinstance(entry, dict) and entry.get("name")
        if not good or not all(isinstance(entry.get(key), str) for key in ("name", "type")):
            advice = f"give a name and a type of {', '.join(sorted(TYPES))}"
            raise ParameterError(f"{name}/plugins has {entry!r}: {advice}")
        if any(layer.name == entry["name"] for layer in declared):
            raise ParameterError(
                f"{name}/plugins has two layers named {entry['name']}: give each a unique name"
            )
        kind = _kind(entry, costmap)
        if kind:
            declared.append(Layer(f"{name}/{entry['name']}", entry["name"], kind))
    return declared


def replaced(tree: Dict[str, Any]) -> Iterator[str]:
    """Yield a warning for each costmap layer whose type is not available, with its replacement."""
    for name in COSTMAPS:
        costmap = branch(tree, name)
        if costmap.get("map_type") == "voxel" and "plugins" not in costmap:
            yield f"{name}/map_type is voxel: an obstacle layer replaces the voxel layer"
        plugins = costmap.get("plugins")
        for entry in plugins if isinstance(plugins, list) else ():
            given = entry.get("type") if isinstance(entry, dict) else None
            if isinstance(given, str) and given not in TYPES:
                instead = (
                    "an obstacle layer replaces it" if _kind(entry, costmap) else "it is left out"
                )
                yield f"{name}/plugins has {given}: this layer type is not available, {instead}"


def _kind(entry: Dict[str, Any], costmap: Dict[str, Any]) -> str:
    """Return the layer type that is used for an entry of a costmap's plugins, or "" if the entry is left out.

    A voxel layer, or another layer of unavailable type with observation sources, becomes an obstacle layer.
    """
    sees = entry["type"] == VOXEL_LAYER or "observation_sources" in branch(
        costmap, str(entry.get("name"))
    )
    return entry["type"] if entry["type"] in TYPES else OBSTACLE_LAYER if sees else ""


def sources(layer: Dict[str, Any]) -> List[str]:
    """Return the names of an obstacle layer's sources."""
    listed = layer.get("observation_sources", "")
    return listed.split() if isinstance(listed, str) else []


def arranged(tree: Dict[str, Any]) -> Dict[str, Any]:
    """Return a tree with the layers' parameters in the sections where C++ reads them. Its costmaps are new dicts.

    Without `plugins`, the list is added and the layers' parameters move from the costmap to the layers. With `plugins`,
    the values that layers inherit are copied to them. Sources get the ranges of the sections above them.
    """
    made = dict(tree)
    made["TrajectoryPlannerROS"] = _with_older_names(tree)
    for name in COSTMAPS:
        given = tree.get(name, {})
        if not isinstance(given, dict):
            continue
        costmap = made[name] = dict(given)
        for key in ("footprint", "robot_radius"):
            if key in tree:
                costmap.setdefault(key, tree[key])
        if "plugins" not in costmap:
            _move_to_layers(costmap)
        for layer in layers(name, costmap):
            own = costmap.get(layer.name, {})
            if not isinstance(own, dict):
                continue
            own = costmap[layer.name] = dict(own)
            own.update({key: costmap[key] for key in TYPES[layer.kind].inherited if key in costmap})
            if layer.kind == OBSTACLE_LAYER:
                _arrange_sources(own, (own, costmap, tree))
                if branch(tree, "applr").get("movers") is True:
                    _add_predicted(own, costmap.get("robot_base_frame", "base_link"))
    return made


def _with_older_names(tree: Dict[str, Any]) -> Any:
    """Return the values of TrajectoryPlannerROS, including values under older names that C++ still reads.

    With another local planner, rotations of recovery read the older names (rotate_recovery.cpp). TrajectoryPlannerROS
    reads an older name only for the slowest turn to the goal heading (trajectory_planner_ros.cpp) and writes the newer
    names before recovery reads them.
    """
    given = tree.get("TrajectoryPlannerROS", {})
    if not isinstance(given, dict):
        return given
    slowest = "min_in_place_vel_theta", "min_in_place_rotational_vel"
    if str(tree.get("base_local_planner", "TrajectoryPlannerROS")).endswith("TrajectoryPlannerROS"):
        return {**given, slowest[1]: given[slowest[0]]} if slowest[0] in given else given
    older = {
        slowest[0]: slowest[1],
        "max_vel_theta": "max_rotational_vel",
        "acc_lim_theta": "acc_lim_th",
    }
    return {
        "yaw_goal_tolerance": 0.1,
        **{now: given[old] for now, old in older.items() if old in given},
        **given,
    }


def _add_predicted(layer: Dict[str, Any], base: str) -> None:
    """Add a source for PREDICTED, with the parameters of the laser, if the layer has a laser that marks and clears."""
    own = [branch(layer, name) for name in sources(layer)]
    lasers = [
        s
        for s in own
        if s.get("data_type") == "LaserScan" and s.get("clearing") and s.get("marking", True)
    ]
    given = [source for source in own if str(source.get("topic")).lstrip("/") == PREDICTED]
    for source in given:  # Files that also configure the C++ node list the source themselves.
        source["topic"] = PREDICTED
    if lasers and not given:
        changed = {"topic": PREDICTED, "data_type": "PointCloud2", "observation_persistence": 0.0}
        layer["applr_predicted"] = {
            "sensor_frame": base,
            **lasers[0],
            **changed,
            "expected_update_rate": 0.0,
        }
        layer["observation_sources"] += " applr_predicted"


def _move_to_layers(costmap: Dict[str, Any]) -> None:
    """Add the layers of files without `plugins` and move their parameters to them."""
    with_map = costmap.get("static_map", False) is True
    own = {
        layer: dict(costmap[layer]) if isinstance(costmap.get(layer), dict) else {}
        for layer, _ in BEFORE_HYDRO
    }
    keys = {layer: TYPES[kind].inherited for layer, kind in BEFORE_HYDRO}
    keys["obstacle_layer"] += ("observation_sources", *sources(costmap))
    for layer, names in keys.items():
        if layer != "static_layer" or with_map:
            own[layer].update({key: costmap[key] for key in names if key in costmap})
    for names in keys.values():
        for key in names:
            if key != "track_unknown_space":  # The costmap itself reads this parameter, too.
                costmap.pop(key, None)
    costmap["plugins"] = [
        {"name": layer, "type": kind}
        for layer, kind in BEFORE_HYDRO
        if layer != "static_layer" or with_map
    ]
    costmap.update({entry["name"]: own[entry["name"]] for entry in costmap["plugins"]})


def _arrange_sources(layer: Dict[str, Any], above: Sequence[Dict[str, Any]]) -> None:
    """Give each source a topic and ranges. A missing range comes from the nearest section above that has it."""
    for name in sources(layer):
        given = layer.get(name)
        own = layer[name] = dict(given) if isinstance(given, dict) else {}
        own.setdefault("topic", name)
        for key in ("obstacle_range", "raytrace_range"):
            inherited = next((section[key] for section in above if key in section), None)
            if key not in own and inherited is not None:
                own[key] = inherited
