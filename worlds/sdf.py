"""Gazebo's SDF for `sdf_reader`: XML without entities, numbers in texts, poses and shapes.

Transforms are composed in three dimensions, then each collision is cut down to what a ground robot meets, a circle or a
rectangle.
"""

from __future__ import annotations

import itertools
import math
import re
from typing import Callable, Dict, List, Optional, Sequence, Tuple
from xml.etree.ElementTree import Element, ParseError

import numpy as np
import scipy
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from applr_ros1.common import files

from .world import WorldError

NAMESPACE = "applr"  # of our own elements: {applr}course, {applr}waypoints
ROBOT_HEIGHTS_M = (0.02, 0.50)  # heights [m] between which an obstacle is in a Jackal's way
UPRIGHT_COSINE = 0.996  # a cylinder whose axis tilts less (5 degrees) counts as upright
Shape = Tuple[float, ...]  # a circle (x, y, radius) or a rectangle (x, y, yaw, size_x, size_y), None if passed by


def parse(path: str) -> Element:
    """The root element of an SDF file. Anything wrong with it is a WorldError of one line."""
    data = files.plain_xml(files.read_bytes(path))
    if data and not data.startswith("<"):
        raise WorldError(f"{path} is no SDF but, say, a world of Stage; give a Gazebo world file")
    # DynaBARN's boilerplate says <pose frame=>, which Gazebo's parser forgives
    try:
        return fromstring(re.sub(r"<(\w+) frame=>", r"<\1>", data), forbid_dtd=True)
    except DefusedXmlException:
        raise WorldError(f"{path} has a DOCTYPE or entities, which are not read; remove them") from None
    except ParseError as error:
        raise WorldError(f"{path} is not well-formed XML ({error}); save the world from Gazebo again") from None


def numbers(text: Optional[str], count: int, what: str) -> List[float]:
    """`count` finite numbers from an element's text. `what` names the thing in the error."""
    words = (text or "").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise WorldError(f"{what} is {' '.join(words)[:60]!r}: give {count} finite numbers")
    return values


def in_the_way(low: float, high: float) -> bool:
    """Return true if something between these heights [m] stands in a Jackal's way."""
    return high > ROBOT_HEIGHTS_M[0] and low < ROBOT_HEIGHTS_M[1]


def cylinder(pose: np.ndarray, radius: float, length: float) -> Optional[Shape]:
    """The circle of an upright cylinder, the rectangle around a lying or leaning one."""
    axis = pose[:3, 2]
    flat = math.hypot(axis[0], axis[1])
    reach = 0.5 * length * abs(axis[2]) + radius * flat
    if not in_the_way(pose[2, 3] - reach, pose[2, 3] + reach):
        return None
    x, y = float(pose[0, 3]), float(pose[1, 3])
    if abs(axis[2]) >= UPRIGHT_COSINE:
        return x, y, radius
    along = length * flat + 2.0 * radius * abs(axis[2])
    return x, y, math.atan2(axis[1], axis[0]), float(along), 2.0 * radius


def sphere(pose: np.ndarray, radius: float) -> Optional[Shape]:
    """The sphere's widest circle."""
    x, y, z = pose[:3, 3].tolist()
    return (x, y, radius) if in_the_way(z - radius, z + radius) else None


def box(pose: np.ndarray, *size: float) -> Optional[Shape]:
    """The rectangle that a box covers, exact if it stands on a face."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    corners = (signs * np.asarray(size)) @ pose[:3, :3].T
    if not in_the_way(pose[2, 3] + corners[:, 2].min(), pose[2, 3] + corners[:, 2].max()):
        return None
    # the axis that lies flattest gives the rectangle's direction; the first one in a tie
    axes = np.hypot(pose[0, :3], pose[1, :3])
    main = int(np.argmax(axes > axes.max() - 1e-9))
    yaw = math.atan2(pose[1, main], pose[0, main])
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = corners[:, 0] * c + corners[:, 1] * s, corners[:, 1] * c - corners[:, 0] * s
    return float(pose[0, 3]), float(pose[1, 3]), yaw, float(np.ptp(along)), float(np.ptp(across))


# shape: the tags of its sizes, how many numbers each has, and what a Jackal meets of it at a pose (4, 4)
SHAPES: Dict[str, Tuple[Sequence[str], int, Callable[..., Optional[Shape]]]] = {
    "cylinder": (("radius", "length"), 1, cylinder),
    "sphere": (("radius",), 1, sphere),
    "box": (("size",), 3, box),
}


def pose_of(element: Element, what: str) -> np.ndarray:
    """An element's pose in its frame, whichever that is, (4, 4). `what` names the element in the error."""
    pose, matrix, words = element.find("pose"), np.eye(4), (element.findtext("pose") or "").split()
    if pose is not None and words:
        values = numbers(" ".join((words + ["0"] * 5)[:6]), 6, "pose, " + what)  # as sdformat fills up
        matrix[:3, 3] = values[:3]
        degrees = pose.get("degrees") in ("true", "1")
        turn = scipy.spatial.transform.Rotation.from_euler("xyz", values[3:], degrees)  # fixed axes: R = Rz Ry Rx
        matrix[:3, :3] = turn.as_matrix()
    return matrix
