"""SDF parsing for `sdf_reader`: XML without entities, numbers in texts, poses and shapes.

Transforms are composed in three dimensions. Each collision is then reduced to its outline on the
ground, a circle or a rectangle.
"""

from __future__ import annotations

import itertools
import math
import re
from typing import Callable, List, NamedTuple, Optional, Sequence, Tuple
from xml.etree.ElementTree import Element

import numpy as np
import scipy
from defusedxml.ElementTree import fromstring

from applr_ros1.common import files
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, shown

NAMESPACE = "applr"  # XML namespace of this package's elements {applr}course and {applr}waypoints
ROBOT_HEIGHTS_M = (0.02, 0.50)  # range of heights in which an obstacle blocks a Jackal [m]
UPRIGHT_COSINE = 0.996  # cosine of the largest tilt of an upright cylinder (5 degrees)
Shape = Tuple[float, ...]  # circle (x, y, radius) or rectangle (x, y, yaw, size_x, size_y)


def parse(path: str) -> Element:
    """Return the root element of an SDF file. Raise FileError if the file is malformed."""
    with files.reading(path, "give a Gazebo world file without DOCTYPE"):
        # DynaBARN's worlds contain <pose frame=>, which Gazebo's parser accepts.
        xml_text = re.sub(r"<(\w+) frame=>", r"<\1>", files.plain_xml(files.read_bytes(path)))
        root: Element = fromstring(xml_text, forbid_dtd=True)
        return root


def numbers(text: Optional[str], count: int, element: str, rows: bool = False) -> List[float]:
    """Return `count` finite numbers from an element's text, or some times as many in `rows`.

    `element` names the element in the message.
    """
    words = (text or "").split()
    try:
        parsed_numbers = [float(word) for word in words]
    except ValueError:
        parsed_numbers = []
    has_count = len(parsed_numbers) == count
    if rows:
        has_count = bool(parsed_numbers) and len(parsed_numbers) % count == 0
    if not has_count or not all(map(math.isfinite, parsed_numbers)):
        given_text = shown(" ".join(words))
        raise ApplrError(f"{element} is {given_text}: give {count} finite numbers")
    return parsed_numbers


def in_the_way(low: float, high: float) -> bool:
    """Return True if an obstacle between these heights [m] blocks a Jackal."""
    return high > ROBOT_HEIGHTS_M[0] and low < ROBOT_HEIGHTS_M[1]


def cylinder(pose: Array, radius: float, length: float) -> Optional[Shape]:
    """Return the circle of an upright cylinder, or the rectangle around a lying or leaning one.

    Return None if the cylinder is not in the way.
    """
    x, y, z = pose[:3, 3].tolist()
    axis_x, axis_y, axis_z = pose[:3, 2].tolist()
    upright = abs(axis_z)  # cosine of the angle between axis and vertical
    horizontal_share = math.hypot(axis_x, axis_y)  # sine of this angle
    half_height = 0.5 * length * upright + radius * horizontal_share
    if not in_the_way(z - half_height, z + half_height):
        return None
    if upright >= UPRIGHT_COSINE:
        return x, y, radius
    # The side of a leaning cylinder and its two end discs, seen from above.
    yaw = math.atan2(axis_y, axis_x)
    size_along = length * horizontal_share + 2.0 * radius * upright
    size_across = 2.0 * radius
    return x, y, yaw, size_along, size_across


def sphere(pose: Array, radius: float) -> Optional[Shape]:
    """Return the sphere's widest circle, or None if the sphere is not in the way."""
    x, y, z = pose[:3, 3].tolist()
    if not in_the_way(z - radius, z + radius):
        return None
    return x, y, radius


def box(pose: Array, *sizes: float) -> Optional[Shape]:
    """Return the rectangle covered by a box, or None if the box is not in the way.

    The rectangle is exact for a box on one of its faces.
    """
    # The eight corners as seen from the centre, in sizes of the box
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    offsets = signs * np.asarray(sizes)
    rotation = pose[:3, :3]
    corners = offsets @ rotation.T
    corner_x, corner_y, corner_z = corners.T
    x, y, z = pose[:3, 3].tolist()
    if not in_the_way(z + corner_z.min(), z + corner_z.max()):
        return None
    # The most horizontal axis gives the direction of the rectangle, and the first axis wins a tie.
    axis_x, axis_y = pose[:2, :3]
    horizontal_shares = np.hypot(axis_x, axis_y)
    main_axis = int(np.argmax(horizontal_shares > horizontal_shares.max() - 1e-9))
    yaw = math.atan2(axis_y[main_axis], axis_x[main_axis])
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    corner_along = corner_x * cosine + corner_y * sine
    corner_across = corner_y * cosine - corner_x * sine
    size_along = float(np.ptp(corner_along))
    size_across = float(np.ptp(corner_across))
    return x, y, yaw, size_along, size_across


class ShapeReader(NamedTuple):
    """How a shape is read: tags of its sizes, and the function of its outline at a pose (4, 4)."""

    tags: Sequence[str]
    numbers_per_tag: int
    outline: Callable[..., Optional[Shape]]


SHAPES = {
    "cylinder": ShapeReader(("radius", "length"), 1, cylinder),
    "sphere": ShapeReader(("radius",), 1, sphere),
    "box": ShapeReader(("size",), 3, box),
}


def pose_of(element: Element, what: str) -> Array:
    """Return an element's pose (4, 4) in its parent frame.

    `what` names the element in the message.
    """
    matrix = np.eye(4)
    pose_element = element.find("pose")
    words = (element.findtext("pose") or "").split()
    if pose_element is None or not words:
        return matrix
    words += ["0"] * 5  # sdformat pads with zeros, too.
    pose_text = " ".join(words[:6])
    pose_numbers = numbers(pose_text, 6, f"pose, {what}")
    matrix[:3, 3] = pose_numbers[:3]
    # Lower case means rotations about fixed axes, as in SDF: R = Rz Ry Rx.
    degrees = pose_element.get("degrees") in ("true", "1")
    rotation = scipy.spatial.transform.Rotation.from_euler("xyz", pose_numbers[3:], degrees)
    matrix[:3, :3] = rotation.as_matrix()
    return matrix
