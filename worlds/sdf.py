"""Gazebo's SDF for `sdf_reader`: bounded XML without entities, numbers in texts, poses and shapes.

Transforms are composed in three dimensions, then each collision is cut down to what a ground robot meets, a circle or a
rectangle.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from typing import List, Optional, Sequence, Tuple
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import iterparse

from applr_ros1.common import files

from .world import WorldError

MAX_BYTES = 16 * 2**20  # BARN's largest world has .8 MB
MAX_TAGS, MAX_DEPTH = 500_000, 100  # 10,000 obstacles have 140,000 tags, models within models some twenty levels
FAR = 10_000.0  # [m]; nothing in a course lies farther out


def parse(path: str) -> Element:
    """The root element of an SDF file. Anything wrong with it is a WorldError of one line."""
    data = files.read_bytes(path, MAX_BYTES)
    # DynaBARN's boilerplate says <pose frame=>, which Gazebo's parser forgives
    text = io.BytesIO(re.sub(rb"<(\w+) frame=>", rb"<\1>", data))
    tags = depth = 0
    try:
        for event, found in iterparse(text, ("start", "end"), forbid_dtd=True):
            root = found  # the last one to end
            tags, depth = (tags + 1, depth + 1) if event == "start" else (tags, depth - 1)
            if tags > MAX_TAGS or depth > MAX_DEPTH:
                break
    except DefusedXmlException:
        raise WorldError(f"{path} has a DOCTYPE or entities, which are not read; remove them") from None
    except (ParseError, LookupError, ValueError) as error:  # the latter two: an encoding that is unknown or wrong
        raise WorldError(f"{path} is not well-formed XML ({error}); save the world from Gazebo again") from None
    if depth:
        raise WorldError(f"{path} has over {MAX_TAGS} tags, or {MAX_DEPTH} levels of them; give a simpler world")
    return root


def numbers(text: Optional[str], count: int, what: str) -> List[float]:
    """`count` finite numbers within +-FAR from an element's text. `what` names the thing in the error."""
    words = (text or "").split()
    try:
        values = [float(w) for w in words]
    except ValueError:
        values = []
    if len(values) != count or len(words) != count:
        raise WorldError(f"{what} is {_short(text)!r}; it must be {count} number{'s' if count > 1 else ''}")
    for value in values:
        if not abs(value) <= FAR:
            raise WorldError(f"{what} is {_short(text)!r}; its numbers must be finite and within {FAR}")
    return values


def _short(text) -> str:
    text = " ".join((text or "").split())
    return text if len(text) <= 60 else text[:57] + "..."


ROBOT_BAND = (0.02, 0.50)  # heights [m] between which an obstacle is in a Jackal's way
UPRIGHT = 0.996  # a cylinder whose axis tilts less (5 degrees) counts as upright

Circle = Tuple[float, float, float]
Rectangle = Tuple[float, float, float, float, float]


def transform(pose: Sequence[float]) -> np.ndarray:
    """(4, 4) from SDF's x y z roll pitch yaw (fixed axes: R = Rz Ry Rx)."""
    x, y, z, roll, pitch, yaw = pose
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y],
            [-sp, cp * sr, cp * cr, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def in_the_way(low: float, high: float) -> bool:
    """Whether something between these heights [m] stands in a Jackal's way."""
    return high > ROBOT_BAND[0] and low < ROBOT_BAND[1]


def cylinder(pose: np.ndarray, radius: float, length: float) -> Tuple[Optional[Circle], Optional[Rectangle]]:
    """What a Jackal meets of a cylinder: (circle, rectangle), one of them None.

    The circle of an upright one, the rectangle around a lying or leaning one, (None, None) for one that a Jackal passes
    under or over.
    """
    axis = pose[:3, 2]
    flat = math.hypot(axis[0], axis[1])
    reach = 0.5 * length * abs(axis[2]) + radius * flat
    if not in_the_way(pose[2, 3] - reach, pose[2, 3] + reach):
        return None, None
    x, y = float(pose[0, 3]), float(pose[1, 3])
    if abs(axis[2]) >= UPRIGHT:
        return (x, y, float(radius)), None
    along = length * flat + 2.0 * radius * abs(axis[2])
    return None, (x, y, math.atan2(axis[1], axis[0]), float(along), 2.0 * float(radius))


def sphere(pose: np.ndarray, radius: float) -> Optional[Circle]:
    """The sphere's widest circle, or None where a Jackal passes under or over it."""
    if not in_the_way(pose[2, 3] - radius, pose[2, 3] + radius):
        return None
    return float(pose[0, 3]), float(pose[1, 3]), float(radius)


def box(pose: np.ndarray, size: Sequence[float]) -> Optional[Rectangle]:
    """The rectangle that a box covers, exact if it stands on a face; None where a Jackal passes under or over."""
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
    return (float(pose[0, 3]), float(pose[1, 3]), yaw, float(np.ptp(along)), float(np.ptp(across)))


def frame_of(element: Element) -> str:
    """What the pose of an element is relative to; "" where it has none or does not say it."""
    pose = element.find("pose")
    return "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""


def pose_of(element: Element, what: str) -> np.ndarray:
    """An element's pose in its frame, whichever that is, (4, 4). `what` names the element in the error."""
    pose = element.find("pose")
    if pose is None or not (pose.text or "").strip():
        return np.eye(4)
    values = numbers(pose.text, 6, "pose, " + what)
    if pose.get("degrees") in ("true", "1"):
        values[3:] = [math.radians(v) for v in values[3:]]
    return transform(values)
