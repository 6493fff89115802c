"""Which layers a costmap has, and where their parameters stand: the rules of costmap_2d_ros.cpp.

Used by the check and completion of parameter trees and by declarations.servers. Pure standard library.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

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
    """A kind of layer.

    config: name of its dynamic_reconfigure type. live: the parameters of that server. static: those that are read
    once. inherited: names that, given at the costmap, replace the layer's own values.
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
    INFLATION_LAYER: LayerType("InflationPlugin", INFLATION, (), ("cost_scaling_factor", "inflation_radius")),
}
INHERITED: Dict[str, Parameter] = {
    p.name: p for kind in TYPES.values() for p in kind.live + kind.static if p.name in kind.inherited
}
VOXEL_LAYER = "costmap_2d::VoxelLayer"
PREDICTED = "applr/predicted"  # topic of the points where moving obstacles will be
FOUND_ABOVE = ("footprint", "robot_radius", "obstacle_range", "raytrace_range")  # at move_base itself, too
# without `plugins`: (name, type); the static layer only with static_map
BEFORE_HYDRO = (
    ("static_layer", STATIC_LAYER),
    ("obstacle_layer", OBSTACLE_LAYER),
    ("inflation_layer", INFLATION_LAYER),
)


class Layer(NamedTuple):
    """A layer of a costmap. path: its place in the parameter tree, such as "local_costmap/obstacle_layer"."""

    path: str
    name: str
    kind: str  # one of TYPES


def layers(name: str, costmap: Dict[str, Any]) -> List[Layer]:
    """The layers of the costmap `name`, from the lowest to the highest, without those of types that are not here.

    ParameterError for a list that is none.
    """
    found: List[Layer] = []
    plugins = costmap.get("plugins", [])
    for entry in plugins if isinstance(plugins, list) else [plugins]:
        good = isinstance(plugins, list) and isinstance(entry, dict) and entry.get("name")
        if not good or not all(isinstance(entry.get(key), str) for key in ("name", "type")):
            advice = f"give a name and a type of {', '.join(sorted(TYPES))}"
            raise ParameterError(f"{name}/plugins has {entry!r}: {advice}")
        if any(layer.name == entry["name"] for layer in found):
            raise ParameterError(f"{name}/plugins has two layers named {entry['name']}: give each its own")
        kind = _kind(entry, costmap)
        if kind:
            found.append(Layer(f"{name}/{entry['name']}", entry["name"], kind))
    return found


def replaced(tree: Dict[str, Any]) -> Iterator[str]:
    """Yield a line for each layer of a tree's costmaps whose type is not here, with what drives in its place."""
    for name in COSTMAPS:
        costmap = branch(tree, name)
        if costmap.get("map_type") == "voxel" and "plugins" not in costmap:
            yield f"{name}/map_type is voxel: an obstacle layer stands for the voxel layer"
        plugins = costmap.get("plugins")
        for entry in plugins if isinstance(plugins, list) else ():
            given = entry.get("type") if isinstance(entry, dict) else None
            if isinstance(given, str) and given not in TYPES:
                instead = "an obstacle layer stands for it" if _kind(entry, costmap) else "the costmap is without it"
                yield f"{name}/plugins has {given}: that layer is not here, {instead}"


def _kind(entry: Dict[str, Any], costmap: Dict[str, Any]) -> str:
    """The type of layer that a costmap has for an entry of its plugins, "" for none.

    An obstacle layer stands for those that are not here and have observation sources.
    """
    sees = entry["type"] == VOXEL_LAYER or "observation_sources" in branch(costmap, str(entry.get("name")))
    return entry["type"] if entry["type"] in TYPES else OBSTACLE_LAYER if sees else ""


def sources(layer: Dict[str, Any]) -> List[str]:
    """The names of an obstacle layer's sources."""
    listed = layer.get("observation_sources", "")
    return listed.split() if isinstance(listed, str) else []


def arranged(tree: Dict[str, Any]) -> Dict[str, Any]:
    """The tree with the layers' parameters where C++ looks for them in the end; the costmaps in it are new dicts.

    Files without `plugins` get their list, and what stands at the costmap moves to the layers. With `plugins`, values
    at the costmap that the layers inherit are copied to them. Sources get the ranges that stand above them.
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
    """The values of TrajectoryPlannerROS, with the older names of rotate_recovery.cpp and trajectory_planner_ros.cpp.

    With another local planner, rotations of recovery read them. This planner itself reads the slowest turn to the goal
    heading so, and has written the newer names for recovery by then.
    """
    given = tree.get("TrajectoryPlannerROS", {})
    if not isinstance(given, dict):
        return given
    slowest = "min_in_place_vel_theta", "min_in_place_rotational_vel"
    if str(tree.get("base_local_planner", "TrajectoryPlannerROS")).endswith("TrajectoryPlannerROS"):
        return {**given, slowest[1]: given[slowest[0]]} if slowest[0] in given else given
    older = {slowest[0]: slowest[1], "max_vel_theta": "max_rotational_vel", "acc_lim_theta": "acc_lim_th"}
    return {"yaw_goal_tolerance": 0.1, **{now: given[old] for now, old in older.items() if old in given}, **given}


def _add_predicted(layer, base) -> None:
    """One more source, of PREDICTED, where a laser marks and clears; all else is as the laser's."""
    own = [branch(layer, name) for name in sources(layer)]
    lasers = [s for s in own if s.get("data_type") == "LaserScan" and s.get("clearing") and s.get("marking", True)]
    given = [source for source in own if str(source.get("topic")).lstrip("/") == PREDICTED]  # as beside C++
    for source in given:
        source["topic"] = PREDICTED
    if lasers and not given:
        changed = {"topic": PREDICTED, "data_type": "PointCloud2", "observation_persistence": 0.0}
        layer["applr_predicted"] = {"sensor_frame": base, **lasers[0], **changed, "expected_update_rate": 0.0}
        layer["observation_sources"] += " applr_predicted"


def _move_to_layers(costmap) -> None:
    """The set of layers that files had before `plugins` existed."""
    with_map = costmap.get("static_map", False) is True
    own = {layer: dict(costmap[layer]) if isinstance(costmap.get(layer), dict) else {} for layer, _ in BEFORE_HYDRO}
    keys = {layer: TYPES[kind].inherited for layer, kind in BEFORE_HYDRO}
    keys["obstacle_layer"] += ("observation_sources", *sources(costmap))
    for layer, names in keys.items():
        if layer != "static_layer" or with_map:
            own[layer].update({key: costmap[key] for key in names if key in costmap})
    for names in keys.values():
        for key in names:
            if key != "track_unknown_space":  # the costmap itself has it, too
                costmap.pop(key, None)
    costmap["plugins"] = [
        {"name": layer, "type": kind} for layer, kind in BEFORE_HYDRO if layer != "static_layer" or with_map
    ]
    costmap.update({entry["name"]: own[entry["name"]] for entry in costmap["plugins"]})


def _arrange_sources(layer, above) -> None:
    """Each source gets its topic, and the ranges of the nearest place above it, where it has none of its own."""
    for name in sources(layer):
        given = layer.get(name)
        own = layer[name] = dict(given) if isinstance(given, dict) else {}
        own.setdefault("topic", name)
        for key in ("obstacle_range", "raytrace_range"):
            found = next((place[key] for place in above if key in place), None)
            if key not in own and found is not None:
                own[key] = found
