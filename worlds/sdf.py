"""SDF parsing for `sdf_reader`: XML without entities, numbers in texts, poses and shapes.

Transforms are composed in three dimensions. Each collision is then reduced to its outline on the ground, a circle or a
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
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError

NAMESPACE = "applr"  # XML namespace of this package's elements {applr}course and {applr}waypoints
ROBOT_HEIGHTS_M = (0.02, 0.50)  # range of heights in which an obstacle blocks a Jackal [m]
UPRIGHT_COSINE = 0.996  # cosine of the largest tilt of an upright cylinder (5 degrees)
Shape = Tuple[float, ...]  # circle (x, y, radius) or rectangle (x, y, yaw, size_x, size_y)


def parse(path: str) -> Element:
    """Return the root element of an SDF file. Raise ApplrError if the file is malformed."""
    # DynaBARN's worlds contain <pose frame=>, which Gazebo's parser accepts.
    data = re.sub(r"<(\w+) frame=>", r"<\1>", files.plain_xml(files.read_bytes(path)))
    try:
        root: Element = fromstring(data, forbid_dtd=True)
    except (DefusedXmlException, ParseError) as error:
        raise ApplrError(f"{path} is not read ({error}): give a Gazebo world file without DOCTYPE") from None
    return root


def numbers(text: Optional[str], count: int, what: str) -> List[float]:
    """Return `count` finite numbers from an element's text. `what` names the element in the message."""
    words = (text or "").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ApplrError(f"{what} is {' '.join(words)[:60]!r}: give {count} finite numbers")
    return values


def in_the_way(low: float, high: float) -> bool:
    """Return True if an obstacle between these heights [m] blocks a Jackal."""
    return high > ROBOT_HEIGHTS_M[0] and low < ROBOT_HEIGHTS_M[1]


def cylinder(pose: Array, radius: float, length: float) -> Optional[Shape]:
    """Return the circle of an upright cylinder, or the rectangle around a lying or leaning cylinder."""
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


def sphere(pose: Array, radius: float) -> Optional[Shape]:
    """Return the sphere's widest circle, or None if the sphere is not in the way."""
    x, y, z = pose[:3, 3].tolist()
    return (x, y, radius) if in_the_way(z - radius, z + radius) else None


def box(pose: Array, *size: float) -> Optional[Shape]:
    """Return the rectangle covered by a box, or None if it is not in the way. Exact for a box on one of its faces."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    corners = (signs * np.asarray(size)) @ pose[:3, :3].T
    if not in_the_way(pose[2, 3] + corners[:, 2].min(), pose[2, 3] + corners[:, 2].max()):
        return None
    # The most horizontal axis gives the direction of the rectangle, and the first axis wins a tie.
    axes = np.hypot(pose[0, :3], pose[1, :3])
    main = int(np.argmax(axes > axes.max() - 1e-9))
    yaw = math.atan2(pose[1, main], pose[0, main])
    c, s = math.cos(yaw), math.sin(yaw)
    along, across = corners[:, 0] * c + corners[:, 1] * s, corners[:, 1] * c - corners[:, 0] * s
    return float(pose[0, 3]), float(pose[1, 3]), yaw, float(np.ptp(along)), float(np.ptp(across))


# By shape: tags of its sizes, numbers per tag, and the function that returns its outline at a pose (4, 4)
SHAPES: Dict[str, Tuple[Sequence[str], int, Callable[..., Optional[Shape]]]] = {
    "cylinder": (("radius", "length"), 1, cylinder),
    "sphere": (("radius",), 1, sphere),
    "box": (("size",), 3, box),
}


def pose_of(element: Element, what: str) -> Array:
    """Return an element's pose (4, 4) in its parent frame. `what` names the element in the message."""
    pose, matrix, words = element.find("pose"), np.eye(4), (element.findtext("pose") or "").split()
    if pose is not None and words:
        values = numbers(" ".join((words + ["0"] * 5)[:6]), 6, "pose, " + what)  # sdformat pads with zeros, too.
        matrix[:3, 3] = values[:3]
        degrees = pose.get("degrees") in ("true", "1")
        turn = scipy.spatial.transform.Rotation.from_euler("xyz", values[3:], degrees)  # about fixed axes: R = Rz Ry Rx
        matrix[:3, :3] = turn.as_matrix()
    return matrix
