"""Reader of the parameter files of a navigation package: parameters of move_base, and limits of the base's controller.

training/robot.py calls `read_parameter_files`, and parameter_files.py reads each file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, Sequence, Set, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import branch, merged
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, SERVERS, STATIC, namespace
from applr_ros1.planner.parameters.layers import COSTMAPS, FOUND_ABOVE, STATIC_LAYER, layers
from applr_ros1.robots.parameter_files import (
    PLACES,
    nested,
    observation_sources,
    of_move_base,
    too_deep,
)
from applr_ros1.robots.robot import number_at

_PLACES = ("", *PLACES)  # namespaces of parameter files below move_base
_LISTS = {
    "": set(FOUND_ABOVE),
    **{costmap: {"observation_sources", "plugins"} for costmap in COSTMAPS},
}
_NAMES: Dict[str, Set[str]] = {
    place: {name for p in SERVERS.get(place, ()) + STATIC.get(place, ()) for name in p.names}
    | _LISTS.get(place, set())
    for place in _PLACES
}
CONTROLLER_TIMEOUT_S = 0.5  # default cmd_vel_timeout of a diff_drive_controller [s]


@dataclass
class Parameters:
    """Content of parameter files.

    Attributes:
        files: (path, namespace below move_base) in the order of loading.
        tree: Nested values of the files, relative to move_base's namespace.
        full: Nested values with all defaults filled in.
        added: Parameters that robot.yaml must give in addition to the files.
        limits: Limits in the controller's file, by field of robot.yaml's section base.
        driven: Joints of the driven wheels in the controller's file.
        notes: Messages for the user.
    """

    files: List[Tuple[str, str]] = field(default_factory=list)
    tree: Dict[str, Any] = field(default_factory=dict)
    full: Dict[str, Any] = field(default_factory=dict)
    added: Dict[str, Any] = field(default_factory=dict)
    limits: Dict[str, float] = field(default_factory=dict)
    driven: List[str] = field(default_factory=list)
    notes: List[str] = field(default_factory=list)

    def frames(self) -> Dict[str, str]:
        """Return the section frames of robot.yaml with the frames of the costmaps."""
        world, local = (self.full[costmap] for costmap in COSTMAPS)
        frames = {
            "base": local["robot_base_frame"],
            "odom": local["global_frame"],
            "map": world["global_frame"],
        }
        frames = {name: frame.lstrip("/") for name, frame in frames.items()}
        static = any(layer.kind == STATIC_LAYER for layer in layers("global_costmap", world))
        if frames["odom"] == frames["map"]:
            frames.pop("odom" if static or frames["map"] == "map" else "map")
        return frames

    @property
    def planner(self) -> Dict[str, Any]:
        """Values of the local planner in the files."""
        return branch(self.tree, namespace(str(self.full["base_local_planner"])))

    def footprint(self) -> np.ndarray:
        """Return the unpadded footprint (n, 2) [m] in the files, empty if there is none."""
        values = self.full["local_costmap"]
        outline = footprint.parse(values["footprint"])
        given = any(
            "robot_radius" in tree for tree in (self.tree, branch(self.tree, "local_costmap"))
        )
        return footprint.circle(values["robot_radius"]) if given and not len(outline) else outline

    def padded_width(self) -> float:
        """Return the width [m] of the padded footprint."""
        return float(np.ptp(footprint.padded(self.full["local_costmap"])[:, 1]))

    def sources(self) -> Iterator[Tuple[str, str, Dict[str, Any]]]:
        """Yield (path of the layer, name, values) of the observation sources of the costmaps."""
        for costmap in COSTMAPS:
            yield from observation_sources(self.full, costmap)

    def scans(self) -> List[Dict[str, Any]]:
        """Return the laser scans among the observation sources."""
        return [source for _, _, source in self.sources() if source["data_type"] == "LaserScan"]

    def one_scan(self, topic: str) -> Tuple[Dict[str, Any], Set[str]]:
        """Return the changes for a simulated robot, whose only sensor data is the laser scan on `topic`.

        Returns:
            Nested observation_sources of the layers that use other topics as well, and these
            topics.
        """
        changes: Dict[str, Any] = {}
        topics = [(path, name, source["topic"].strip("/")) for path, name, source in self.sources()]
        others = {(path, other) for path, _, other in topics if other != topic.strip("/")}
        for layer in sorted({path for path, _ in others}):
            costmap = layer.partition("/")[0]
            place = layer if "plugins" in branch(self.tree, costmap) else costmap
            kept = [
                name
                for path, name, other in topics
                if path == layer and (path, other) not in others
            ]
            branch(changes, place, create=True)["observation_sources"] = " ".join(kept)
        return changes, {other for _, other in others}

    def without_map(self, odom: str, size: int) -> Dict[str, Any]:
        """Return the changes for a course without a map, on which the laser fills an empty costmap in the frame `odom`.

        Args:
            odom: Name of the odometry frame.
            size: Width and height of the global costmap [m].
        """
        changes: Dict[str, Any] = {}
        for costmap in COSTMAPS:
            tree = branch(self.tree, costmap)
            change: Dict[str, Any] = {}
            if tree.get("global_frame", "map") != odom:
                change["global_frame"] = odom
            if tree.get("static_map") and "plugins" not in tree:
                change["static_map"] = False
            static = [layer.name for layer in layers(costmap, tree) if layer.kind == STATIC_LAYER]
            if static:
                plugins = [entry for entry in tree["plugins"] if entry["name"] not in static]
                # A global costmap with only the map gets the obstacle layers of the local costmap.
                local = branch(self.tree, "local_costmap").get("plugins", [])
                seeing = [path for path, _, _ in self.sources()]
                if not any(path.startswith(f"{costmap}/") for path in seeing):
                    plugins = [
                        entry for entry in local if f"local_costmap/{entry['name']}" in seeing
                    ] + plugins
                change["plugins"] = plugins
            if change and costmap == "global_costmap":
                change.update(
                    rolling_window=False,
                    width=size,
                    height=size,
                    origin_x=-size / 2,
                    origin_y=-size / 2,
                )
            if change:
                changes[costmap] = change
        if changes and branch(self.tree, "NavfnROS").get("allow_unknown") is False:
            changes["NavfnROS"] = {"allow_unknown": True}  # All space is unknown at first.
        return changes


def read_parameter_files(given: Sequence[str]) -> Parameters:
    """Read the parameter files of a navigation package.

    Args:
        given: FILE or FILE:NAMESPACE in the order of the launch file, with the NAMESPACE of
            <rosparam ns="..."> inside the node move_base. The output of roslaunch --dump-params is
            one FILE.

    Raises:
        ApplrError: A file cannot be read or lacks its namespace, no file is for move_base, or the
            planner refuses the values.
    """
    parameters = Parameters()
    controllers: List[Dict[str, Any]] = []
    for path, _, place in (text.partition(":") for text in given):
        place = re.sub("^/?(move_base(/|$))?", "", place.rstrip("/"))
        whole = nested(path)
        values, own = of_move_base(whole), list(_controllers(whole))
        controllers += own
        if own and not place and not set(values) & {*_NAMES[""], *_PLACES}:
            continue
        _check_namespace(path, place, values)
        parameters.files.append((path, place))
        tree: Dict[str, Any] = {}
        branch(tree, place, create=True).update(values)
        parameters.tree = merged(parameters.tree, tree)
    for line in too_deep(parameters.tree):
        raise ApplrError(line)
    if not branch(parameters.tree, "local_costmap"):
        raise ApplrError(
            "the parameter files have no local_costmap: give all files that the launch file loads"
        )
    if len(controllers) > 1:
        parameters.notes.append(
            "the files have several base controllers, so none is used: fill in the base's limits"
        )
    elif controllers:
        parameters.limits, parameters.driven = _limits(controllers[0]), _driven(controllers[0])
    present = [plugin for plugin in LOCAL_PLANNERS if namespace(plugin) in parameters.tree]
    # The files do not name the planner: a launch file, which is not read, does.
    if "base_local_planner" not in parameters.tree and present == [LOCAL_PLANNERS[1]]:
        parameters.added["base_local_planner"] = present[0]
    parameters.tree = merged(parameters.tree, parameters.added)
    parameters.full = complete(parameters.tree)
    return parameters


def _check_namespace(path: str, place: str, values: Dict[str, Any]) -> None:
    """Raise ApplrError if a file of a costmap or local planner is given without its namespace."""
    for name in values if not place else ():
        places = [place for place in _PLACES if name in _NAMES[place]]
        if places and "" not in places:
            choices = " and ".join(f"{path}:{place}" for place in places)
            raise ApplrError(
                f"{path}: {name} is no parameter of move_base itself: give the namespace of the file in your launch "
                f"file ({choices}), or omit a file of another node"
            )


def _controllers(tree: Dict[str, Any]) -> Iterator[Dict[str, Any]]:
    """Yield the sections of nested parameters that belong to a diff_drive_controller or have its limits."""
    for value in filter(lambda value: isinstance(value, dict), tree.values()):
        if "left_wheel" in value or branch(value, "linear/x") or branch(value, "angular/z"):
            yield value
        else:
            yield from _controllers(value)


def _driven(controller: Dict[str, Any]) -> List[str]:
    """Return the joints driven by a controller."""
    given = (controller.get(name, []) for name in ("left_wheel", "right_wheel"))
    return [str(name) for side in given for name in (side if isinstance(side, list) else [side])]


def _limits(controller: Dict[str, Any]) -> Dict[str, float]:
    """Return the limits of a controller, by field of robot.yaml's section base."""
    limits: Dict[str, float] = {}
    for axis, speed, change in (
        ("linear/x", "max_speed", "max_acceleration"),
        ("angular/z", "max_yaw_rate", "max_yaw_acceleration"),
    ):
        for kind, ours in (("velocity", speed), ("acceleration", change)):
            limit = number_at(controller, axis, (f"max_{kind}",))
            if branch(controller, axis).get(f"has_{kind}_limits") is True and limit is not None:
                limits[ours] = limit
    known = "diff_drive_controller" in str(controller.get("type"))
    timeout = controller.get("cmd_vel_timeout", CONTROLLER_TIMEOUT_S if known else None)
    return {**limits, "command_timeout": timeout} if timeout is not None else limits
