"""Reader of Gazebo SDF worlds, including those of BARN and DynaBARN, into a World.

`worlds.loading` calls `read_world`. Poses of models, links and collisions are composed, each relative to its parent. A
saved <state> overrides the poses of its models. Elements that are not supported (meshes, includes, other frames) are
reported in one warning, and the other elements form the world.
"""

from __future__ import annotations

import logging
import os
from typing import List, Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common.angles import outside_box
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError

from . import course, dynabarn
from .dynabarn import Animation
from .sdf import NAMESPACE, SHAPES, Shape, numbers, parse, pose_of
from .world import Mover, World

IGNORED_INCLUDES = ("model://sun", "model://ground_plane")
NOTHING_THERE = ("empty", "plane")  # geometries that are no obstacle
FLOOR_HEIGHT_M = 0.1  # largest height of the top of a floor slab [m]
MAX_NAMED = 5  # number of unsupported elements named in the warning


def read_world(path: str, points: Optional[Array] = None) -> World:
    """Return the world of a .world file, and log unsupported elements in one warning.

    Args:
        path: World file.
        points: Course (n, 2) [m]. By default, the course is the one that `sdf_writer` stored in the file, or that of
            path_files/path_N.npy beside the file.

    Raises:
        ApplrError: The file cannot be read or has no course.
    """
    name = os.path.splitext(os.path.basename(path))[0]
    root = parse(path)
    world = root if root.tag == "world" else root.find("world")
    if world is None:
        raise ApplrError(f"{path} contains no <world>; give a Gazebo world file")
    cylinders, boxes, low, movers = _Reader(path, world).read()
    stored = world.find(f"{{{NAMESPACE}}}course")
    if points is not None:
        way = course.along(path, points)
    else:
        way = course.beside(path, cylinders, movers) if stored is None else course.from_element(stored, path)
    # Low boxes are obstacles, except for the floor slabs on which the robot stands at the start.
    stands_on = [np.hypot(*outside_box(*(way.start[:2] - box[:2]), *box[2:])) == 0.0 for box in low]
    return World(name, cylinders, np.concatenate([boxes, low[~np.array(stands_on, bool)]]), way, movers)


class _Reader:
    """One pass over a <world>. `path` appears in messages and locates DynaBARN's key frames."""

    def __init__(self, path: str, world: Element) -> None:
        self.path, self.world = path, world
        self.cylinders: List[Shape] = []
        self.boxes: List[Shape] = []
        self.low: List[Shape] = []  # boxes whose top is within FLOOR_HEIGHT_M, so that they may be floor slabs
        self.movers: List[Mover] = []
        self.unread: List[str] = []

    def read(self) -> Tuple[Array, Array, Array, Tuple[Mover, ...]]:
        """Return cylinders (n, 3), boxes (m, 5), low boxes (k, 5) and moving obstacles, as in worlds.World."""
        for tag in ("actor", "population", "road", "state/insertions/model"):
            self.unread += [f"<{tag}>" for _ in self.world.findall(tag)]
        for include in self.world.iter("include"):
            uri = (include.findtext("uri") or "").strip().rstrip("/")
            if uri not in IGNORED_INCLUDES:
                self.unread.append(f"the include {uri!r}")
        saved = {model.get("name"): model for model in self.world.findall("state/model")}
        for model in self.world.findall("model"):
            self._model(model, np.eye(4), saved.get(model.get("name")), ("", "world"))
        if self.unread:
            more = f" and {len(self.unread) - MAX_NAMED} more" if len(self.unread) > MAX_NAMED else ""
            what = ", ".join(self.unread[:MAX_NAMED])
            logging.getLogger(__name__).warning("%s: not supported: %s%s; ignored", self.path, what, more)
        cylinders, boxes, low = (
            np.array(shapes, dtype=np.float64).reshape(-1, n)
            for shapes, n in ((self.cylinders, 3), (self.boxes, 5), (self.low, 5))
        )
        return cylinders, boxes, low, tuple(self.movers)

    def _known(self, element: Element, frames: Tuple[str, ...], what: str) -> bool:
        """Return True if an element's pose is relative to its parent. Otherwise note the element as unsupported."""
        pose = element.find("pose")
        frame = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        frame = element.get("placement_frame") or frame
        if frame not in frames:
            self.unread.append(f"{what} (its pose is relative to {frame!r})")
        return frame in frames

    def _model(self, model: Element, parent: Array, saved: Optional[Element], frames: Tuple[str, ...]) -> None:
        """Read a model and the models in it. saved: The model's element in a <state>, or None.

        parent, frames: Pose (4, 4) of the parent in the world, and names by which a <pose> may refer to the parent.
        """
        name = f"model {model.get('name')!r}"
        what = f"{name} in {self.path}"
        if not self._known(model, frames, name):
            return
        pose = parent @ pose_of(model, what)
        if saved is not None and saved.find("pose") is not None:  # Poses in a <state> are in the world frame.
            pose = pose_of(saved, f"state of {what}")
        if saved is not None and numbers(saved.findtext("scale", "1 1 1"), 3, f"scale, state of {what}") != [1.0] * 3:
            self.unread.append(f"the scale of {name}")
        animation = dynabarn.animation_of(model, self.path)
        for link in model.findall("link"):
            if self._known(link, ("", "__model__"), f"link {link.get('name')!r} of {name}"):
                self._link(link, pose @ pose_of(link, f"link {link.get('name')!r} of {what}"), what, animation)
        for inner in model.findall("model"):
            self._model(inner, pose, None, ("", "__model__"))

    def _link(self, link: Element, pose: Array, model: str, animation: Optional[Animation]) -> None:
        for collision in link.findall("collision"):
            name = f"collision {collision.get('name')!r}"
            if not self._known(collision, ("", link.get("name", "")), name):
                continue
            there = pose @ pose_of(collision, f"{name} of {model}")
            for element in collision.iterfind("geometry/*"):
                if element.tag in SHAPES:
                    self._shape(element, there, f"{name} of {model}", animation)
                elif element.tag not in NOTHING_THERE:
                    self.unread.append(f"{name} of {model.partition(' in ' + self.path)[0]} (a {element.tag})")

    def _shape(self, element: Element, pose: Array, what: str, animation: Optional[Animation]) -> None:
        tags, count, cut = SHAPES[element.tag]
        sizes = [size for tag in tags for size in numbers(element.findtext(tag), count, f"{tag}, {what}")]
        shape = cut(pose, *sizes)
        if shape is not None and len(shape) > 3:
            half = 0.5 * np.abs(pose[2, :3]) @ sizes if element.tag == "box" else np.inf
            (self.low if pose[2, 3] + half <= FLOOR_HEIGHT_M else self.boxes).append(shape)
        elif shape is not None and animation is not None:
            self.movers.append(animation(shape[2]))
        elif shape is not None:
            self.cylinders.append(shape)
