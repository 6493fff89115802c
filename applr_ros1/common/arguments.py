"""Parsers for command lines and parameters of programs that ROS may start."""

from __future__ import annotations

import math
import sys
from typing import Any, List, Optional, Sequence, Tuple

from applr_ros1.common.errors import ApplrError


def without_remappings(arguments: Optional[Sequence[str]] = None) -> List[str]:
    """Return the arguments (default: sys.argv's) without ROS remappings (NAME:=VALUE), like rospy.myargv."""
    return [word for word in (sys.argv[1:] if arguments is None else arguments) if ":=" not in word]


def number_within(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> float:
    """Return `value` if it is a number from `low` to `high`, otherwise raise ApplrError."""
    if not isinstance(value, bool) and isinstance(value, (int, float)) and low <= value <= high:
        return value
    between = "" if math.isinf(low) and math.isinf(high) else f" from {low:g} to {high:g}"
    raise ApplrError(f"{name} is {value!r}: give a number{between}")


def boolean(name: str, text: str) -> bool:
    """Parse a boolean in the spelling of launch files. Raise ApplrError for any other text."""
    if text.lower() not in ("true", "false", "1", "0"):
        raise ApplrError(f"{name} is {text or 'empty'}: give true or false")
    return text.lower() in ("true", "1")


def pose(name: str, text: str) -> Tuple[float, float, float]:
    """Parse "x y yaw" into a tuple [m, m, rad]. Raise ApplrError unless these are three finite numbers."""
    try:
        x, y, yaw = map(float, text.replace(",", " ").split())
    except ValueError:
        x = y = yaw = math.nan
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ApplrError(f"{name} is {text or 'empty'}: give three numbers 'x y yaw' in metres and radians")
    return x, y, yaw


def frame_prefix(text: str) -> str:
    """Return the prefix of a robot's frames: "robot1/" for "robot1", "" for "none" or an empty text."""
    return "" if text.strip("/") in ("", "none") else text.strip("/") + "/"
