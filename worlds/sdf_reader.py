"""Gazebo SDF worlds, BARN's and DynaBARN's among them, read unchanged into a World.

`worlds.loading` calls `read`. Model, link and collision poses are composed; a saved <state> overrides them, as it does
in Gazebo.
"""

from __future__ import annotations

import os
from typing import Dict, List, NamedTuple, Optional
from xml.etree.ElementTree import Element

import numpy as np

from . import course, dynabarn, sdf
from .dynabarn import Animation
from .sdf import IDENTITY, WORLD, Scope, frame_of, numbers, parse, pose_of
from .world import Mover, World, WorldError

MAX_OBSTACLES = 10_000  # BARN's worlds have up to 365
IGNORED_INCLUDES = ("model://sun", "model://ground_plane")
NOTHING_THERE = ("empty", "plane")  # geometries without an obstacle


def read_world(path: str) -> World:
    """World from a .world file.

    The course comes from the file itself where our writer put one, else from path_files/path_N.npy beside it, else
    from a search. Raises WorldError with one line.
    """
    name = os.path.splitext(os.path.basename(path))[0]
    root = parse(path)
    world = root if root.tag == "world" else root.find("world")
    if world is None:
        raise WorldError(f"{path} holds no <world>; give a Gazebo world file")
    obstacles = _Reader(path, world).read()
    stated = world.find(f"{{{course.NAMESPACE}}}course")
    way = course.beside(path, *obstacles) if stated is None else course.from_element(stated, path)
    return World(name, obstacles.cylinders, obstacles.boxes, way, obstacles.movers)


class Obstacles(NamedTuple):
    """Cylinders (n, 3), boxes (m, 5) and movers as in worlds.World."""

    cylinders: np.ndarray
    boxes: np.ndarray
    movers: tuple


class _State(NamedTuple):
    """What a saved <state> says of one model: its pose in the world, its scale, its links' poses in the world."""

    pose: Optional[np.ndarray]
    scale: np.ndarray
    links: Dict[str, np.ndarray]
    models: Dict[str, "_State"]


_NO_STATE = _State(None, np.ones(3), {}, {})


class _Reader:
    """One pass over a <world>. `path` is for error lines, and tells where DynaBARN's key frames lie."""

    def __init__(self, path: str, world: Element):
        self.path, self.world = path, world
        self.cylinders: List[tuple] = []
        self.boxes: List[tuple] = []
        self.movers: List[Mover] = []
        self.animations = dynabarn.Animations(path, course.NAMESPACE)

    def read(self) -> Obstacles:
        for tag in ("population", "road"):
            if self.world.find(tag) is not None:
                raise WorldError(
                    f"{self.path} has a <{tag}>, which is not read; save the world from Gazebo with its models inline"
                )
        for include in self.world.iter("include"):
            uri = (include.findtext("uri") or "").strip().rstrip("/")
            if uri not in IGNORED_INCLUDES:
                raise WorldError(
                    f"{self.path} includes {uri[:80]!r}, which is not read; save the world from Gazebo with its "
                    "models inline"
                )
        states = self._states(self.world)
        scope = Scope(self.world, f"the world in {self.path}")
        for model in [*self._models_of_state(), *self.world.findall("model")]:
            self._model(model, scope, IDENTITY, states)
        return Obstacles(
            np.array(self.cylinders, dtype=np.float64).reshape(-1, 3),
            np.array(self.boxes, dtype=np.float64).reshape(-1, 5),
            tuple(self.movers),
        )

    def _states(self, parent: Element) -> Dict[str, _State]:
        states: Dict[str, _State] = {}
        for state in parent.findall("state") if parent is self.world else [parent]:
            for model in state.findall("model"):
                what = f"state of model {model.get('name')!r} in {self.path}"
                links = {
                    link.get("name", ""): self._saved(link, f"link {link.get('name')!r}, {what}")
                    for link in model.findall("link")
                    if link.find("pose") is not None
                }
                text = model.findtext("scale")
                scale = [1.0, 1.0, 1.0] if text is None else numbers(text, 3, "scale, " + what)
                if min(scale) <= 0.0:
                    raise WorldError(f"scale, {what} is {scale}; it must be above 0")
                states[model.get("name", "")] = _State(
                    self._saved(model, what) if model.find("pose") is not None else None,
                    np.array(scale),
                    links,
                    self._states(model),
                )
        return states

    def _models_of_state(self):
        for state in self.world.findall("state"):
            for insertions in state.findall("insertions"):
                for model in insertions.findall("model"):
                    yield model

    @staticmethod
    def _saved(element: Element, what: str) -> np.ndarray:
        """A pose in a <state>, which is always in the world."""
        if frame_of(element) not in ("", WORLD):
            raise WorldError(
                f"pose, {what} is relative to {frame_of(element)[:60]!r}, but what a <state> saves is relative to the "
                "world; leave relative_to out"
            )
        return pose_of(element, what)

    def _model(self, model: Element, around: Scope, parent: np.ndarray, states: Dict[str, _State]) -> None:
        """`around`: the world or the model that it is in, which stands at the pose `parent`."""
        name = f"model {model.get('name')!r} in {self.path}"
        if model.get("placement_frame"):
            raise WorldError(f"{name} has a placement_frame, which is not read; give the pose of the model itself")
        state = states.get(model.get("name", ""), _NO_STATE)
        place = around.place(model, name)
        scope = Scope(model, name, around.in_world @ place)
        pose = parent @ place if state.pose is None else state.pose
        animation, movers = self.animations.of(model), len(self.movers)
        for link in model.findall("link"):
            self._link(link, scope, pose, state, animation)
        if animation is not None and len(self.movers) == movers:
            raise WorldError(f"{name} has key frames, but no cylinder or sphere that moves; give it one")
        for inner in model.findall("model"):
            self._model(inner, scope, pose, state.models)

    def _link(
        self, link: Element, model: Scope, model_pose: np.ndarray, state: _State, animation: Optional[Animation]
    ) -> None:
        place = model.place(link, f"link {link.get('name')!r} of {model.what}")
        stated = state.links.get(link.get("name", ""))
        pose = model_pose @ place if stated is None else stated
        for collision in link.findall("collision"):
            what = f"collision {collision.get('name')!r} of {model.what}"
            geometry = collision.find("geometry")
            if geometry is None:
                raise WorldError(f"{what} has no <geometry>; give it a box or a cylinder")
            in_link = pose_of(collision, what)
            if frame_of(collision):
                in_link = np.linalg.inv(place) @ model.frame(frame_of(collision), what) @ in_link
            self._collision(geometry, pose @ in_link, state.scale, what, animation)
            if len(self.cylinders) + len(self.boxes) + len(self.movers) > MAX_OBSTACLES:
                raise WorldError(f"{self.path} has more than {MAX_OBSTACLES} obstacles; give a world with fewer")

    def _collision(
        self, geometry: Element, pose: np.ndarray, scale: np.ndarray, what: str, animation: Optional[Animation]
    ) -> None:
        for shape in geometry:
            circle = rectangle = None
            if shape.tag == "cylinder":
                radius = self._size(shape, "radius", what) * float(max(scale[:2]))
                circle, rectangle = sdf.cylinder(pose, radius, self._size(shape, "length", what) * scale[2])
            elif shape.tag == "sphere":
                circle = sdf.sphere(pose, self._size(shape, "radius", what) * float(max(scale)))
            elif shape.tag == "box":
                size = numbers(shape.findtext("size"), 3, "size, " + what)
                if min(size) <= 0.0:
                    raise WorldError(f"size, {what} is {size}; it must be above 0")
                rectangle = sdf.box(pose, np.array(size) * scale)
            elif shape.tag not in NOTHING_THERE:
                raise WorldError(
                    f"{what} is a {shape.tag!r}; only box, cylinder, sphere and plane are read, replace it"
                )
            if animation is not None and circle:
                self.movers.append(Mover(circle[2], animation.frames, animation.length, animation.repeat))
            elif circle:
                self.cylinders.append(circle)
            elif rectangle:
                self.boxes.append(rectangle)

    @staticmethod
    def _size(shape: Element, tag: str, what: str) -> float:
        value = numbers(shape.findtext(tag), 1, f"{tag}, {what}")[0]
        if value <= 0.0:
            raise WorldError(f"{tag}, {what} is {value:g}; it must be above 0")
        return value
