"""Layers of a costmap and the sections of their parameters, by the rules of costmap_2d_ros.cpp.

Used by the check and completion of parameter trees and by declarations.servers. Uses only the
standard library.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, NamedTuple, Sequence, Tuple

from applr_ros1.common.errors import shown
from applr_ros1.planner.parameters.costmap_parameters import (
    INFLATION,
    OBSTACLES,
    STATIC_MAP,
    STATIC_OBSTACLES,
    STATIC_STATIC_MAP,
)
from applr_ros1.planner.parameters.parameter import Parameter, ParameterError
from applr_ros1.planner.parameters.trees import Tree, branch

COSTMAPS = ("global_costmap", "local_costmap")


class LayerType(NamedTuple):
    """Type of a layer.

    Attributes:
        config: name of the layer's dynamic_reconfigure type.
        live: parameters of the layer's dynamic_reconfigure server.
        static: parameters that are read once.
        inherited: names of parameters that replace the layer's own value if they are given at the
            costmap.
    """

    config: str
    live: Tuple[Parameter, ...]
    static: Tuple[Parameter, ...]
    inherited: Tuple[str, ...]


STATIC_LAYER = "costmap_2d::StaticLayer"
OBSTACLE_LAYER = "costmap_2d::ObstacleLayer"
INFLATION_LAYER = "costmap_2d::InflationLayer"
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
        "InflationPlugin",
        INFLATION,
        (),
        ("cost_scaling_factor", "inflation_radius"),
    ),
}


def _inherited() -> Dict[str, Parameter]:
    """Return the declarations of all parameters that layers inherit from their costmap."""
    inherited = {}
    for layer_type in TYPES.values():
        for parameter in layer_type.live + layer_type.static:
            if parameter.name in layer_type.inherited:
                inherited[parameter.name] = parameter
    return inherited


INHERITED = _inherited()
VOXEL_LAYER = "costmap_2d::VoxelLayer"
PREDICTED = "applr/predicted"  # topic of the predicted obstacle points
# Costmap parameters that may also be given at move_base itself: C++ searches for them upwards.
FOUND_ABOVE = ("footprint", "robot_radius", "obstacle_range", "raytrace_range")
# Layers (name, type) of a costmap without `plugins`. The static layer requires static_map.
BEFORE_HYDRO = (
    ("static_layer", STATIC_LAYER),
    ("obstacle_layer", OBSTACLE_LAYER),
    ("inflation_layer", INFLATION_LAYER),
)


class LayerSection(NamedTuple):
    """Section of a costmap's layer in the parameter tree."""

    path: str  # section in the parameter tree, such as "local_costmap/obstacle_layer"
    name: str
    kind: str  # one of TYPES
    values: Tree  # parameters of the section; empty if there are none

    @property
    def sources(self) -> List[str]:
        """Names of its observation sources; none unless it is an obstacle layer."""
        return sources(self.values) if self.kind == OBSTACLE_LAYER else []


class SourceSection(NamedTuple):
    """Section of an obstacle layer's observation source in the parameter tree."""

    layer: str  # section of the layer
    name: str
    values: Tree  # parameters of the section; empty if there are none

    @property
    def path(self) -> str:
        """Section in the parameter tree, such as "local_costmap/obstacle_layer/laser"."""
        return f"{self.layer}/{self.name}"


def layers(name: str, costmap: Tree, kind: str = "") -> List[LayerSection]:
    """Return the layers of the costmap `name`, lowest first: all, or those of one kind.

    Layers whose type is not available are left out.

    Raises:
        ParameterError: `plugins` is not a list of names and types, or a name occurs twice.
    """
    available_layers: List[LayerSection] = []
    plugins = costmap.get("plugins", [])
    for entry in plugins if isinstance(plugins, list) else [plugins]:
        # C++ stops with an exception of XmlRpc here.
        if not isinstance(plugins, list) or not _is_named_and_typed(entry):
            advice = f"give a name and a type of {', '.join(sorted(TYPES))}"
            raise ParameterError(f"{name}/plugins has {shown(entry)}: {advice}")
        layer_name = entry["name"]
        if any(layer.name == layer_name for layer in available_layers):
            problem = f"{name}/plugins has two layers named {layer_name}"
            raise ParameterError(f"{problem}: give each a unique name")
        layer_kind = _kind(entry, costmap)
        if layer_kind:
            path = f"{name}/{layer_name}"
            values = branch(costmap, layer_name)
            available_layers.append(LayerSection(path, layer_name, layer_kind, values))
    return [layer for layer in available_layers if kind in ("", layer.kind)]


def _is_named_and_typed(entry: Any) -> bool:
    """Return whether an entry of `plugins` has the texts name, not empty, and type."""
    if not isinstance(entry, dict) or not isinstance(entry.get("type"), str):
        return False
    name = entry.get("name")
    return isinstance(name, str) and bool(name)


def replaced(tree: Tree) -> Iterator[str]:
    """Yield a warning for each costmap layer whose type is not available.

    The warning says what replaces the layer, or that it is left out.
    """
    for costmap_name in COSTMAPS:
        costmap = branch(tree, costmap_name)
        if costmap.get("map_type") == "voxel" and "plugins" not in costmap:
            yield f"{costmap_name}/map_type is voxel: an obstacle layer replaces the voxel layer"
        plugins = costmap.get("plugins")
        for entry in plugins if isinstance(plugins, list) else ():
            kind = entry.get("type") if isinstance(entry, dict) else None
            if not isinstance(kind, str) or kind in TYPES:
                continue
            result = "it is left out"
            if _kind(entry, costmap):
                result = "an obstacle layer replaces it"
            yield f"{costmap_name}/plugins has {kind}: this layer type is not available, {result}"


def _kind(entry: Tree, costmap: Tree) -> str:
    """Return the layer type that is used for an entry of `plugins`, or "" if the entry is left out.

    A voxel layer, or another layer of unavailable type with observation sources, becomes an
    obstacle layer.
    """
    kind: str = entry["type"]
    if kind in TYPES:
        return kind
    # Layers of other packages with sources mark and clear, too, such as spatio-temporal ones.
    values = branch(costmap, str(entry.get("name")))
    if kind == VOXEL_LAYER or "observation_sources" in values:
        return OBSTACLE_LAYER
    return ""


def sources(layer: Tree) -> List[str]:
    """Return the names of an obstacle layer's sources."""
    listed = layer.get("observation_sources", "")
    return listed.split() if isinstance(listed, str) else []


def observation_sources(name: str, costmap: Tree) -> Iterator[SourceSection]:
    """Yield the observation sources of the costmap `name`. Errors are those of layers()."""
    for layer in layers(name, costmap):
        for source_name in layer.sources:
            yield SourceSection(layer.path, source_name, branch(layer.values, source_name))


def marking_lasers(layer: Tree) -> List[str]:
    """Return the names of an obstacle layer's sources in which a laser marks and clears."""
    names = []
    for source_name in sources(layer):
        source = branch(layer, source_name)
        is_laser = source.get("data_type") == "LaserScan"
        if is_laser and source.get("clearing") and source.get("marking", True):
            names.append(source_name)
    return names


def section_in_files(tree: Tree, path: str) -> str:
    """Return the section of parameter files that holds the values of a section as C++ reads it.

    A costmap without `plugins` has its layers' values, and their sources, in its own section, which
    replace those of the layers. A source that only a layer's section has stays there.

    Args:
        tree: Parameters of the files.
        path: Section of a layer or a source, or any other section: "local_costmap/obstacle_layer".
    """
    costmap, _, layer_path = path.partition("/")
    if not layer_path or "plugins" in branch(tree, costmap):
        return path
    _, _, source = layer_path.partition("/")
    section_path = f"{costmap}/{source}".rstrip("/")
    if branch(tree, path) and not branch(tree, section_path):
        return path
    return section_path


def arranged(tree: Tree) -> Tree:
    """Return a tree with the layers' parameters in the sections where C++ reads them.

    Without `plugins`, the list is added and the layers' parameters move from the costmap to the
    layers. With `plugins`, the values that layers inherit are copied to them. Sources get the
    ranges of the sections above them. The costmaps of the result are new dicts.
    """
    result = dict(tree)
    result["TrajectoryPlannerROS"] = _with_older_names(tree)
    for costmap_name in COSTMAPS:
        if isinstance(tree.get(costmap_name, {}), dict):
            result[costmap_name] = _arranged_costmap(costmap_name, tree)
    return result


def _arranged_costmap(name: str, tree: Tree) -> Tree:
    """Return the section of the costmap `name` of a tree as `arranged` does."""
    costmap = dict(tree.get(name, {}))
    # Costmap2DROS reads both from the costmap's own name space, or else from above.
    for key in ("footprint", "robot_radius"):
        if key in tree:
            costmap.setdefault(key, tree[key])
    if "plugins" not in costmap:
        _move_to_layers(costmap)
    for layer in layers(name, costmap):
        if not isinstance(costmap.get(layer.name, {}), dict):
            continue  # The check reports a section that is no mapping.
        section = dict(layer.values)
        costmap[layer.name] = section
        for key in TYPES[layer.kind].inherited:
            if key in costmap:
                section[key] = costmap[key]
        if layer.kind == OBSTACLE_LAYER:
            _arrange_sources(section, (section, costmap, tree))
            if branch(tree, "applr").get("movers") is True:
                _add_predicted(section, costmap.get("robot_base_frame", "base_link"))
    return costmap


def _with_older_names(tree: Tree) -> Any:
    """Return the values of TrajectoryPlannerROS, also under older names that C++ still reads.

    With another local planner, rotations of recovery read the older names (rotate_recovery.cpp).
    TrajectoryPlannerROS reads an older name only for the slowest turn to the goal heading
    (trajectory_planner_ros.cpp) and writes the newer names before recovery reads them.
    """
    planner_values = tree.get("TrajectoryPlannerROS", {})
    if not isinstance(planner_values, dict):
        return planner_values
    slowest = "min_in_place_vel_theta"
    older_slowest = "min_in_place_rotational_vel"
    planner = str(tree.get("base_local_planner", "TrajectoryPlannerROS"))
    if planner.endswith("TrajectoryPlannerROS"):
        if slowest not in planner_values:
            return planner_values
        return {**planner_values, older_slowest: planner_values[slowest]}

    values = {"yaw_goal_tolerance": 0.1}  # default of rotate_recovery.cpp
    older_names = {
        slowest: older_slowest,
        "max_vel_theta": "max_rotational_vel",
        "acc_lim_theta": "acc_lim_th",
    }
    for name, older_name in older_names.items():
        if older_name in planner_values:
            values[name] = planner_values[older_name]
    return {**values, **planner_values}


def _add_predicted(layer: Tree, base: str) -> None:
    """Add a source for PREDICTED if the layer has a laser that marks and clears.

    The source has the parameters of the first such laser. base: frame of the robot.
    """
    lasers = marking_lasers(layer)
    is_given = False
    for source_name in sources(layer):
        source = branch(layer, source_name)
        # Files that also configure the C++ node list the source themselves.
        if str(source.get("topic")).lstrip("/") == PREDICTED:
            source["topic"] = PREDICTED
            is_given = True
    if lasers and not is_given:
        layer["applr_predicted"] = {
            "sensor_frame": base,
            **layer[lasers[0]],
            "topic": PREDICTED,
            "data_type": "PointCloud2",
            "observation_persistence": 0.0,
            "expected_update_rate": 0.0,
        }
        layer["observation_sources"] += " applr_predicted"


def _move_to_layers(costmap: Tree) -> None:
    """Add the layers of files without `plugins` and move their parameters to them."""
    # Costmap2DROS::loadOldParameters does the same on the parameter server.
    moved_names = {layer_name: TYPES[kind].inherited for layer_name, kind in BEFORE_HYDRO}
    moved_names["obstacle_layer"] += ("observation_sources", *sources(costmap))

    # Two layers may take the same parameter, so it is removed only after all have it.
    plugins = []
    sections = {}
    for layer_name, kind in BEFORE_HYDRO:
        if layer_name == "static_layer" and costmap.get("static_map", False) is not True:
            continue
        values = costmap.get(layer_name)
        section = dict(values) if isinstance(values, dict) else {}
        for parameter_name in moved_names[layer_name]:
            if parameter_name in costmap:
                section[parameter_name] = costmap[parameter_name]
        plugins.append({"name": layer_name, "type": kind})
        sections[layer_name] = section
    for names in moved_names.values():
        for parameter_name in names:
            # The costmap itself reads this parameter, too.
            if parameter_name != "track_unknown_space":
                costmap.pop(parameter_name, None)
    costmap["plugins"] = plugins
    costmap.update(sections)


def _arrange_sources(layer: Tree, sections: Sequence[Tree]) -> None:
    """Give each source of a layer a topic and ranges.

    A missing range comes from the first of the sections that has it: the layer and those above it.
    """
    for source_name in sources(layer):
        values = layer.get(source_name)
        source = dict(values) if isinstance(values, dict) else {}
        layer[source_name] = source
        source.setdefault("topic", source_name)
        for range_name in ("obstacle_range", "raytrace_range"):
            inherited = next(
                (section[range_name] for section in sections if range_name in section), None
            )
            if inherited is not None:
                source.setdefault(range_name, inherited)
