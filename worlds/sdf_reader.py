"""Reader of Gazebo SDF worlds, including those of BARN and DynaBARN, into a World.

`worlds.loading` calls `read_world`. Poses of models, links and collisions are composed, each
relative to its parent. A saved <state> overrides the poses of its models. Elements that are not
supported (meshes, includes, other frames) are reported in one warning, and the other elements form
the world.
"""

from __future__ import annotations

import logging
import os
from typing import List, Optional, Tuple
from xml.etree.ElementTree import Element

import numpy as np

from applr_ros1.common.angles import outside_box
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.common.files import reading

from . import course_files, dynabarn
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
        points: Course (n, 2) [m]. By default, the course is the one that `sdf_writer` stored in the
            file, that of path_files/path_N.npy beside the file, or that of DynaBARN.

    Raises:
        FileError: The file cannot be read or has no course.
    """
    with reading(path):
        world_name, _ = os.path.splitext(os.path.basename(path))
        root = parse(path)
        element: Optional[Element] = root
        if root.tag != "world":
            element = root.find("world")
        if element is None:
            raise ApplrError("the file contains no <world>; give a Gazebo world file")
        reader = _Reader(path)
        reader.read(element)

        cylinders = as_array(reader.cylinders, 3)
        movers = tuple(reader.movers)
        stored_course = element.find(f"{{{NAMESPACE}}}course")
        if points is not None:
            world_course = course_files.along(points)
        elif stored_course is not None:
            world_course = course_files.from_element(stored_course)
        else:
            world_course = course_files.beside(path, cylinders, movers)

        # Low boxes are obstacles, except for floor slabs on which the robot stands at the start.
        x, y, _ = world_course.start
        boxes = list(reader.boxes)
        for slab in reader.low_boxes:
            slab_x, slab_y, yaw, size_x, size_y = slab
            if outside_box(x - slab_x, y - slab_y, yaw, size_x, size_y) != (0.0, 0.0):
                boxes.append(slab)
        return World(world_name, cylinders, as_array(boxes, 5), world_course, movers)


def as_array(shapes: List[Shape], columns: int) -> Array:
    """Return shapes as an array (n, columns), which may have no rows."""
    return np.array(shapes, dtype=np.float64).reshape(-1, columns)


class _Reader:
    """One pass over a <world>.

    Args:
        path: File of the world, which appears in messages and locates DynaBARN's key frames.

    Attributes:
        cylinders: Circles x, y, radius [m].
        boxes: Rectangles x, y, yaw, size_x, size_y [m, rad].
        low_boxes: Boxes whose top is within FLOOR_HEIGHT_M, so that they may be floor slabs.
        movers: Moving obstacles.
        unread: Elements that are not supported.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.cylinders: List[Shape] = []
        self.boxes: List[Shape] = []
        self.low_boxes: List[Shape] = []
        self.movers: List[Mover] = []
        self.unread: List[str] = []

    def read(self, world: Element) -> None:
        """Read the obstacles of a <world>, and log unsupported elements in one warning."""
        # They may be obstacles, but their shapes are not those of a <model> of the world.
        for tag in ("actor", "population", "road", "state/insertions/model"):
            self.unread += [f"<{tag}>"] * len(world.findall(tag))
        for include in world.iter("include"):
            uri_text = include.findtext("uri") or ""
            include_uri = uri_text.strip().rstrip("/")
            if include_uri not in IGNORED_INCLUDES:
                self.unread.append(f"the include {shown(include_uri)}")
        saved_models = {model.get("name"): model for model in world.findall("state/model")}
        for model in world.findall("model"):
            saved_state = saved_models.get(model.get("name"))
            self._model(model, np.eye(4), saved_state, ("", "world"))
        if self.unread:
            element_names = ", ".join(self.unread[:MAX_NAMED])
            if len(self.unread) > MAX_NAMED:
                element_names += f" and {len(self.unread) - MAX_NAMED} more"
            logger = logging.getLogger(__name__)
            logger.warning("%s: not supported: %s; ignored", self.path, element_names)

    def _is_relative_to(self, element: Element, frames: Tuple[str, ...], what: str) -> bool:
        """Return True if an element's pose is relative to one of the names of its parent.

        Otherwise note the element as unsupported.
        """
        pose_element = element.find("pose")
        frame_name = element.get("placement_frame") or ""
        if not frame_name and pose_element is not None:
            frame_name = pose_element.get("relative_to") or pose_element.get("frame") or ""
        if frame_name in frames:
            return True
        # Resolving other frames would need the whole frame graph of SDF.
        self.unread.append(f"{what} (its pose is relative to {shown(frame_name)})")
        return False

    def _model(
        self, model: Element, parent: Array, saved: Optional[Element], frames: Tuple[str, ...]
    ) -> None:
        """Read a model and the models in it.

        Args:
            model: Element of the model.
            parent: Pose (4, 4) of the parent in the world.
            saved: Element of the model in a <state>, or None.
            frames: Names by which a <pose> may refer to the parent.
        """
        model_name = f"model {shown(model.get('name'))}"
        if not self._is_relative_to(model, frames, model_name):
            return
        model_pose = parent @ pose_of(model, model_name)
        if saved is not None:
            if saved.find("pose") is not None:
                model_pose = pose_of(saved, f"state of {model_name}")  # It is in the world frame.
            scale = numbers(saved.findtext("scale", "1 1 1"), 3, f"scale, state of {model_name}")
            if scale != [1.0, 1.0, 1.0]:
                self.unread.append(f"the scale of {model_name}")

        animation = dynabarn.animation_of(model, self.path)
        for link in model.findall("link"):
            link_name = f"link {shown(link.get('name'))}"
            if self._is_relative_to(link, ("", "__model__"), f"{link_name} of {model_name}"):
                link_pose = model_pose @ pose_of(link, f"{link_name} of {model_name}")
                self._link(link, link_pose, model_name, animation)
        # The saved state of a model inside another model is not read.
        for inner_model in model.findall("model"):
            self._model(inner_model, model_pose, None, ("", "__model__"))

    def _link(self, link: Element, pose: Array, model: str, animation: Optional[Animation]) -> None:
        """Read the collisions of a link at a pose (4, 4). `model` names its model in messages."""
        for collision in link.findall("collision"):
            collision_name = f"collision {shown(collision.get('name'))}"
            if not self._is_relative_to(collision, ("", link.get("name", "")), collision_name):
                continue
            title = f"{collision_name} of {model}"
            collision_pose = pose @ pose_of(collision, title)
            for element in collision.iterfind("geometry/*"):
                if element.tag in SHAPES:
                    self._shape(element, collision_pose, title, animation)
                elif element.tag not in NOTHING_THERE:
                    self.unread.append(f"{title} (a {element.tag})")

    def _shape(
        self, element: Element, pose: Array, title: str, animation: Optional[Animation]
    ) -> None:
        """Add the outline of a shape at a pose (4, 4) to the obstacles of its kind."""
        shape_reader = SHAPES[element.tag]
        sizes = []
        for tag in shape_reader.tags:
            size_text = element.findtext(tag)
            sizes += numbers(size_text, shape_reader.numbers_per_tag, f"{tag}, {title}")
        outline = shape_reader.outline(pose, *sizes)
        if outline is None:
            return
        # Only round obstacles move, as in DynaBARN. A box with an animation stays where it starts.
        if len(outline) == 3 and animation is not None:
            self.movers.append(animation(outline[2]))
        elif len(outline) == 3:
            self.cylinders.append(outline)
        elif element.tag == "box" and top_of_box(pose, sizes) <= FLOOR_HEIGHT_M:
            self.low_boxes.append(outline)
        else:
            self.boxes.append(outline)


def top_of_box(pose: Array, sizes: List[float]) -> float:
    """Return the height [m] of the highest corner of a box with three sizes [m] at a pose."""
    # share of each axis of the box that points up, and height of the centre
    *upward_shares, centre_z = pose[2]
    return float(centre_z + 0.5 * np.abs(upward_shares) @ sizes)
