"""Reader of the parameter files of a navigation package.

They hold parameters of move_base, and limits of the base's controller.

training/robot.py calls `read_parameter_files`, and parameter_files.py reads each file.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from math import nan
from typing import Dict, Iterator, List, Sequence, Set, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, SERVERS, STATIC, namespace
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    FOUND_ABOVE,
    STATIC_LAYER,
    SourceSection,
    layers,
    observation_sources,
)
from applr_ros1.planner.parameters.trees import Tree, branch, merged
from applr_ros1.robots.check import crossing_outlines
from applr_ros1.robots.parameter_files import (
    PLACES,
    check_resolved,
    nested,
    of_move_base,
    too_deep,
)
from applr_ros1.robots.robot import number_at
from applr_ros1.robots.urdf_import.description import StatedWheels

NAMESPACES = ("", *PLACES)  # namespaces of parameter files below move_base


def _names_below(namespace: str) -> Set[str]:
    """Return the names of all parameters and lists that a namespace below move_base has."""
    names: Set[str] = set()
    # Those that reconfigure changes, and those read at the start alone
    for parameter in SERVERS.get(namespace, ()) + STATIC.get(namespace, ()):
        names.update(parameter.names)
    if namespace in COSTMAPS:
        names.update(("observation_sources", "plugins"))
    return names


_NAMES = {place: _names_below(place) for place in NAMESPACES}
_NAMES[""].update(FOUND_ABOVE)
CONTROLLER_TIMEOUT_S = 0.5  # default cmd_vel_timeout of a diff_drive_controller [s]
# Parameters of robot_controllers/DiffDriveBaseController with their defaults
# (diff_drive_base.cpp, init), by field of robot.yaml's section base
DIFF_DRIVE_BASE = {
    "max_speed": ("max_velocity_x", 1.0),
    "max_acceleration": ("max_acceleration_x", 0.75),
    "max_yaw_rate": ("max_velocity_r", 4.5),
    "max_yaw_acceleration": ("max_acceleration_r", 3.0),
    "command_timeout": ("timeout", 0.25),
}


@dataclass
class Parameters:
    """Content of parameter files.

    Attributes:
        files: (path, namespace below move_base) in the order of loading.
        tree: Nested values of the files, relative to move_base's namespace.
        full: Nested values with all defaults filled in.
        added: Parameters that robot.yaml must give in addition to the files.
        limits: Limits in the controller's file, by field of robot.yaml's section base.
        wheels: What the controller's file states about the driven wheels; empty without one.
        notes: Messages for the user.
    """

    files: List[Tuple[str, str]] = field(default_factory=list)
    tree: Tree = field(default_factory=dict)
    full: Tree = field(default_factory=dict)
    added: Tree = field(default_factory=dict)
    limits: Dict[str, float] = field(default_factory=dict)
    wheels: List[StatedWheels] = field(default_factory=list)
    notes: List[str] = field(default_factory=list)

    def frames(self) -> Dict[str, str]:
        """Return the section frames of robot.yaml with the frames of the costmaps."""
        local_costmap = self.full["local_costmap"]
        global_costmap = self.full["global_costmap"]
        frames = {
            "base": local_costmap["robot_base_frame"].lstrip("/"),
            "odom": local_costmap["global_frame"].lstrip("/"),
            "map": global_costmap["global_frame"].lstrip("/"),
        }
        if frames["odom"] == frames["map"]:
            # Both costmaps have one frame: the map's if there is one, else the odometry's.
            has_map = bool(layers("global_costmap", global_costmap, STATIC_LAYER))
            is_of_map = has_map or frames["map"] == "map"
            frames.pop("odom" if is_of_map else "map")
        return frames

    @property
    def planner(self) -> Tree:
        """Values of the local planner in the files."""
        return branch(self.tree, namespace(str(self.full["base_local_planner"])))

    def outline(self) -> Array:
        """Return the unpadded footprint (n, 2) [m] in the files, empty if there is none."""
        values = self.full["local_costmap"]
        outline = footprint.parse(values["footprint"])
        # robot_radius has a default, which says nothing about the robot.
        has_radius = "robot_radius" in {**self.tree, **branch(self.tree, "local_costmap")}
        if has_radius and not len(outline):
            return footprint.circle(values["robot_radius"])
        return outline

    def padded_width(self) -> float:
        """Return the width [m] of the padded footprint."""
        return float(np.ptp(footprint.padded(self.full["local_costmap"])[:, 1]))

    def sources(self) -> Iterator[SourceSection]:
        """Yield the observation sources of the costmaps."""
        for costmap in COSTMAPS:
            yield from observation_sources(costmap, self.full[costmap])

    def scans(self) -> List[Tree]:
        """Return the values of the laser scans among the observation sources."""
        sections = [source.values for source in self.sources()]
        return [values for values in sections if values["data_type"] == "LaserScan"]

    def one_scan(self, topic: str) -> Tuple[Tree, Set[str]]:
        """Return the changes for a simulated robot with the laser scan on `topic` alone.

        Returns:
            Nested observation_sources of the layers that use other topics as well, and these
            topics.
        """
        scan_topic = topic.strip("/")
        kept_sources: Dict[str, List[str]] = {}  # names of the sources on the scan's topic by layer
        other_topics: Dict[str, List[str]] = {}  # topics of the other sources by layer
        for source in self.sources():
            source_topic = source.values["topic"].strip("/")
            kept_sources.setdefault(source.layer, [])
            if source_topic == scan_topic:
                kept_sources[source.layer].append(source.name)
            else:
                other_topics.setdefault(source.layer, []).append(source_topic)
        # A simulated robot has one laser: a layer would wait for its other sources.
        changes: Tree = {}
        for layer in sorted(other_topics):
            list_owner = layer.partition("/")[0]
            # Without the list `plugins`, C++ reads the sources of all layers at the costmap.
            if "plugins" in branch(self.tree, list_owner):
                list_owner = layer
            section = branch(changes, list_owner, create=True)
            section["observation_sources"] = " ".join(kept_sources[layer])
        return changes, set().union(*other_topics.values())

    def without_map(self, odom: str, size: int) -> Tree:
        """Return the changes for a course without a map.

        There, the laser fills an empty costmap in the frame `odom`.

        Args:
            odom: Name of the odometry frame.
            size: Width and height of the global costmap [m].
        """
        changes = {}
        for costmap in COSTMAPS:
            change = self._costmap_without_map(costmap, odom)
            # A course begins at the origin of the odometry, in the middle of a fixed costmap.
            if change and costmap == "global_costmap":
                change.update(rolling_window=False, width=size, height=size)
                change.update(origin_x=-size / 2, origin_y=-size / 2)
            if change:
                changes[costmap] = change
        if changes and branch(self.tree, "NavfnROS").get("allow_unknown") is False:
            changes["NavfnROS"] = {"allow_unknown": True}  # All space is unknown at first.
        return changes

    def _costmap_without_map(self, costmap: str, odom: str) -> Tree:
        """Return the changes of a costmap: the odometry's frame, and no layers with a map."""
        costmap_values = branch(self.tree, costmap)
        change: Tree = {}
        # costmap_2d's default is the frame "map".
        if costmap_values.get("global_frame", "map") != odom:
            change["global_frame"] = odom
        if costmap_values.get("static_map") and "plugins" not in costmap_values:
            change["static_map"] = False
        map_layers = [layer.name for layer in layers(costmap, costmap_values, STATIC_LAYER)]
        if map_layers:
            change["plugins"] = []
            # A global costmap with only the map gets the obstacle layers of the local costmap.
            if not list(observation_sources(costmap, self.full[costmap])):
                change["plugins"] += self._local_obstacle_layers()
            for entry in costmap_values["plugins"]:
                if entry["name"] not in map_layers:
                    change["plugins"].append(entry)
        return change

    def _local_obstacle_layers(self) -> List[Tree]:
        """Return the entries in `plugins` of the local costmap's layers that have sources."""
        sources = observation_sources("local_costmap", self.full["local_costmap"])
        layer_paths = {source.layer for source in sources}
        entries = []
        for entry in branch(self.tree, "local_costmap").get("plugins", []):
            if f"local_costmap/{entry['name']}" in layer_paths:
                entries.append(entry)
        return entries


def read_parameter_files(specifications: Sequence[str]) -> Parameters:
    """Read the parameter files of a navigation package.

    Args:
        specifications: FILE or FILE:NAMESPACE in the order of the launch file, with the NAMESPACE
            of <rosparam ns="..."> inside the node move_base. The output of roslaunch --dump-params
            is one FILE.

    Raises:
        ApplrError: A file cannot be read or lacks its namespace, no file is for move_base, the
            planner refuses the values, or a footprint crosses itself.
    """
    parameters = Parameters()
    controllers = []
    unread = {}  # names that may be of no use, by file
    for specification in specifications:
        file_path, _, namespace_below = specification.partition(":")
        # A namespace may be given as it stands in a launch file or on the parameter server.
        namespace_below = re.sub("^/?(move_base(/|$))?", "", namespace_below.rstrip("/"))
        content = nested(file_path)
        file_controllers = list(_controllers({"": content}))
        controllers += file_controllers
        for controller in file_controllers:
            check_resolved(controller, file_path)
        values = of_move_base(content, file_path)
        if not namespace_below:
            unread[file_path] = _unread_in(content, values, file_controllers)
        has_move_base = bool(set(values) & {*_NAMES[""], *NAMESPACES})
        if file_controllers and not has_move_base:
            continue  # The file has a controller alone.
        _check_namespace(file_path, namespace_below, values)
        parameters.files.append((file_path, namespace_below))
        # As for roslaunch, later files override earlier ones.
        tree: Tree = {}
        branch(tree, namespace_below, create=True).update(values)
        parameters.tree = merged(parameters.tree, tree)
    for error_message in too_deep(parameters.tree):
        raise ApplrError(error_message)  # Only the first error is reported.
    if not branch(parameters.tree, "local_costmap"):
        remedy = "give all files that the launch file loads"
        raise ApplrError(f"the parameter files have no local_costmap: {remedy}")
    if len(controllers) > 1:
        remedy = "fill in the base's limits"
        parameters.notes.append(
            f"the files have several base controllers, so none is used: {remedy}"
        )
    elif controllers:
        parameters.limits = _limits(controllers[0])
        parameters.wheels = [_wheels(controllers[0])]
    present_planners = [plugin for plugin in LOCAL_PLANNERS if namespace(plugin) in parameters.tree]
    # The files do not name the planner: a launch file, which is not read, does.
    if "base_local_planner" not in parameters.tree and present_planners == [LOCAL_PLANNERS[1]]:
        parameters.added["base_local_planner"] = present_planners[0]
    parameters.tree = merged(parameters.tree, parameters.added)
    parameters.full = complete(parameters.tree)
    for error_message in crossing_outlines(parameters.full):
        raise ApplrError(error_message)
    unused_parts = []
    known_names = {*_NAMES[""], *parameters.full}
    for file_path, names in unread.items():
        unused_names = [name for name in names if name not in known_names]
        if unused_names:
            unused_parts.append(f"{', '.join(unused_names)} in {os.path.basename(file_path)}")
    if unused_parts:
        parameters.notes.append(f"not used: {'; '.join(unused_parts)}")
    return parameters


def _unread_in(content: Tree, values: Tree, controllers: List[Tree]) -> List[str]:
    """Return the paths of the largest parts of a file without parameters of move_base.

    Args:
        content: All that the file holds.
        values: The level of move_base in it.
        controllers: Sections of base controllers, which are read.
    """
    read_ids = {id(section) for section in controllers}
    names = []
    if values is not content:
        names += _unread(content, read_ids | {id(values)})
    if id(values) not in read_ids:
        names += _unread(values, read_ids)
    return names


def _unread(tree: Tree, read_ids: Set[int]) -> List[str]:
    """Return the paths of the largest parts of a tree that have none of the sections read."""
    names = []
    for name, value in tree.items():
        if id(value) in read_ids:
            continue
        inner_names = _unread(value, read_ids) if isinstance(value, dict) else []
        if not isinstance(value, dict) or inner_names == list(value):
            names.append(name)
        else:
            names += [f"{name}/{inner_name}" for inner_name in inner_names]
    return names


def _check_namespace(path: str, namespace_below: str, values: Tree) -> None:
    """Raise ApplrError if a file of a costmap or local planner is given without its namespace."""
    if namespace_below:
        return
    # At move_base itself, these parameters would have no effect, which nobody would notice.
    for parameter_name in values:
        owners = [owner for owner in NAMESPACES if parameter_name in _NAMES[owner]]
        if owners and "" not in owners:
            choices = " and ".join(f"{path}:{owner}" for owner in owners)
            raise ApplrError(
                f"{path}: {parameter_name} is no parameter of move_base itself: give the "
                f"namespace of the file in your launch file ({choices}), or omit a file of another "
                "node"
            )


def _controllers(tree: Tree) -> Iterator[Tree]:
    """Yield the sections that belong to a controller of a base, or have its limits."""
    for value in tree.values():
        if not isinstance(value, dict):
            continue
        has_limits = branch(value, "linear/x") or branch(value, "angular/z")
        if "left_wheel" in value or has_limits or _is_diff_drive_base(value):
            yield value
        else:
            yield from _controllers(value)


def _is_diff_drive_base(controller: Tree) -> bool:
    """Return whether a section belongs to a robot_controllers/DiffDriveBaseController."""
    return "DiffDriveBaseController" in str(controller.get("type"))


def _wheels(controller: Tree) -> StatedWheels:
    """Return what a controller's file states about the driven wheels."""
    sides = {}
    for side in ("left", "right"):
        joint_names = controller.get(f"{side}_wheel", [])
        if _is_diff_drive_base(controller):
            parameter_name = f"{side[0]}_wheel_joint"
            joint_names = controller.get(parameter_name, parameter_name)  # its default is the same
        # A controller of two wheels may name one without a list.
        if not isinstance(joint_names, list):
            joint_names = [joint_names]
        sides.update(dict.fromkeys(map(str, joint_names), side))
    lengths = []
    for parameter_name in ("wheel_radius", "wheel_separation"):
        lengths.append(number_at(controller, "", (parameter_name,)) or nan)
    return StatedWheels("the controller's file", sides, *lengths)


def _limits(controller: Tree) -> Dict[str, float]:
    """Return the limits of a controller, by field of robot.yaml's section base."""
    limits = {}
    if _is_diff_drive_base(controller):
        for field_name, (parameter_name, default) in DIFF_DRIVE_BASE.items():
            limit = number_at(controller, "", (parameter_name,))
            limits[field_name] = default if limit is None else limit
        return limits
    for axis_path, limit_kind, field_name in (
        ("linear/x", "velocity", "max_speed"),
        ("linear/x", "acceleration", "max_acceleration"),
        ("angular/z", "velocity", "max_yaw_rate"),
        ("angular/z", "acceleration", "max_yaw_acceleration"),
    ):
        limit = number_at(controller, axis_path, (f"max_{limit_kind}",))
        # A limit counts only if its has_..._limits is true (diff_drive_controller).
        counts = branch(controller, axis_path).get(f"has_{limit_kind}_limits") is True
        if counts and limit is not None:
            limits[field_name] = limit
    # Another controller may wait without a limit.
    if "diff_drive_controller" in str(controller.get("type")):
        limits["command_timeout"] = CONTROLLER_TIMEOUT_S
    timeout = controller.get("cmd_vel_timeout")
    if timeout is not None:
        limits["command_timeout"] = timeout
    return limits
