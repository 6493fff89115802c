"""The frames to which poses in a Gazebo world may be relative: SDF 1.7's pose semantics. Only `sdf_reader` uses it.

A `relative_to` (in older files `frame`) names the <world> as "world", the <model> around it as "__model__", or a model,
link, joint or <frame> beside it; without one a pose is relative to the element that it stands in. Frames tell where
things are at the beginning; a saved <state> moves models and links later.
"""

from __future__ import annotations

import math
from typing import Dict, List
from xml.etree.ElementTree import Element

import numpy as np

from . import sdf_geometry
from .sdf_xml import numbers
from .world import WorldError

NAMED = ("model", "link", "joint", "frame")  # elements whose name is that of a frame
WORLD, MODEL = "world", "__model__"
IDENTITY = np.eye(4)


def frame_of(element: Element) -> str:
    """What the pose of an element is relative to; "" where it has none or does not say it."""
    pose = element.find("pose")
    return "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""


def pose_of(element: Element, what: str) -> np.ndarray:
    """An element's pose in its frame, whichever that is, (4, 4). `what` names the element in the error."""
    pose = element.find("pose")
    if pose is None or not (pose.text or "").strip():
        return IDENTITY
    values = numbers(pose.text, 6, "pose, " + what)
    if pose.get("degrees") in ("true", "1"):
        values[3:] = [math.radians(v) for v in values[3:]]
    return sdf_geometry.transform(values)


class Scope:
    """The frames in a <world> or a <model>, all relative to its own one.

    what      names the element in errors
    in_world  where its own frame is in the world at the beginning, (4, 4)
    """

    def __init__(self, element: Element, what: str, in_world: np.ndarray = IDENTITY):
        self.what, self.in_world = what, in_world
        self._known = {"": IDENTITY, MODEL: IDENTITY, WORLD: np.linalg.inv(in_world)}
        if element.tag == WORLD:
            del self._known[MODEL]
        self._elements: Dict[str, List[Element]] = {}
        for child in element:
            if child.tag in NAMED:
                self._elements.setdefault(child.get("name", ""), []).append(child)

    def place(self, element: Element, what: str) -> np.ndarray:
        """Where a model or link of this scope is at the beginning. Raises WorldError."""
        return self.frame(frame_of(element), what) @ pose_of(element, what)

    def frame(self, name: str, what: str) -> np.ndarray:
        """Where a frame is, (4, 4). Raises WorldError; `what` names the element whose pose is relative to it."""
        way: Dict[str, np.ndarray] = {}  # frames that are not known yet, and their poses in the next
        while name not in self._known:
            if name in way:
                raise WorldError(f"pose, {what} is relative to {name[:60]!r}, which is relative to itself")
            found = self._elements.get(name, [])
            if len(found) != 1:
                raise WorldError(
                    f"pose, {what} is relative to {name[:60]!r}, but {self.what} has "
                    f"{'more than one' if found else 'no'} frame of this name; name one of its own frames, or none"
                )
            what = f"{found[0].tag} {name[:60]!r} of {self.what}"
            way[name] = pose_of(found[0], what)
            name = frame_of(found[0]) or found[0].get("attached_to") or (found[0].findtext("child") or "").strip()
        known = self._known[name]
        for name, pose in reversed(list(way.items())):
            known = self._known[name] = known @ pose
        return known
