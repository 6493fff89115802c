"""A robot's move_base parameters under examination, and where in its files each of them stands."""

from __future__ import annotations

import os
from typing import Any, Dict, Iterator, Tuple

import numpy as np

from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.layers import OBSTACLE_LAYER, Layer, layers, sources
from applr_ros1.robots import Robot, geometry
from applr_ros1.robots.parameter_files import FILE


class Setup:
    """The parameters with or without a map.

    Attributes:
        robot: The robot.
        with_map: Which of its parameters.
        tree: What the files give, nested.
        full: The same with defaults (planner.parameters.check.complete); empty until it is known that they can be used.
        planner: Name space of the local planner.
        size: (length, width) [m] of body and wheels.
    """

    def __init__(self, robot: Robot, with_map: bool):
        self.robot, self.with_map = robot, with_map
        self.tree, self.full = robot.parameters(with_map), {}  # type: Dict[str, Any], Dict[str, Any]
        self.planner = robot.local_planner
        back, front, right, left = self.box = geometry.bounding_box(robot)
        self.size = front - back, left - right
        self._places: Dict[str, Tuple[str, str]] = {}  # {path in the tree: (file, path in it)}
        for file in robot.move_base.files_with_map if with_map else robot.move_base.files_without_map:
            start = file.namespace.strip("/")
            for path in _paths(file.values):
                full = "/".join(filter(None, (start, path)))
                if path or full not in self._places:
                    self._places[full] = (os.path.join(robot.folder, file.file), path)

    def value(self, name: str) -> Any:
        """The local planner's value of a parameter, its default where the files give none."""
        return self.full[self.planner][name]

    def where(self, path: str) -> str:
        """File and key of a parameter, such as "/home/me/my_robot/costmap.yaml: footprint" for local_costmap/footprint.

        A layer's value may stand at its costmap, a planner's line may leave its name space out.
        """
        first, _, rest = path.partition("/")
        ends = [known for known in self._places if known.endswith("/" + path)]
        for candidate in (path, f"{first}/{rest.rpartition('/')[2]}", f"{self.planner}/{path}", *ends[:1]):
            if candidate in self._places:
                file, key = self._places[candidate]
                return f"{file}: {key or candidate}"
        above, _, name = path.rpartition("/")  # not given: where the rest of its section is
        if above:
            return f"{self.where(above)}/{name}"
        return f"{os.path.join(self.robot.folder, FILE)}: move_base: {path}"

    def placed(self, line: str) -> str:
        """A line that begins with a parameter's path, with file and key instead."""
        path = line.split()[0].rstrip(",:")
        return self.where(path) + line[len(path) :]

    def own(self, line: str) -> str:
        """A line about a field of robot.yaml, with which it begins."""
        return f"{os.path.join(self.robot.folder, FILE)}: {line}"

    def outline(self, costmap: str) -> np.ndarray:
        """The padded footprint (n, 2) [m] of a costmap."""
        own = self.full[costmap]
        points = footprint.parse(own["footprint"])
        return footprint.pad(points if len(points) else footprint.circle(own["robot_radius"]), own["footprint_padding"])

    def layers(self, costmap: str, kind: str) -> Iterator[Layer]:
        """The layers of this kind in a costmap."""
        return (layer for layer in layers(costmap, self.full[costmap]) if layer.kind == kind)

    def sources(self, costmap: str) -> Iterator[Tuple[str, Dict[str, Any]]]:
        """(path, values) of the observation sources of a costmap."""
        for layer in self.layers(costmap, OBSTACLE_LAYER):
            own = self.full[costmap][layer.name]
            for name in sources(own):
                yield f"{layer.path}/{name}", own[name]


def _paths(tree: Dict[str, Any]) -> Iterator[str]:
    """The paths of a tree and of all that is in it; its own is empty."""
    yield ""
    for name, value in tree.items():
        for path in _paths(value) if isinstance(value, dict) else [""]:
            yield f"{name}/{path}".rstrip("/")
