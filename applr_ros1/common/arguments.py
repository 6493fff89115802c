"""Parsers for command lines and parameters of programs that ROS may start."""

from __future__ import annotations

import math
import sys
from typing import Any, Collection, List, Optional, Sequence

from applr_ros1.common.angles import Pose
from applr_ros1.common.errors import ApplrError, shown


def without_remappings(arguments: Optional[Sequence[str]] = None) -> List[str]:
    """Return the arguments (default: sys.argv's) without ROS remappings, like rospy.myargv.

    A remapping is NAME:=VALUE.
    """
    if arguments is None:
        arguments = sys.argv[1:]
    return [argument for argument in arguments if ":=" not in argument]


def check_names(words: Sequence[str], known: Collection[str]) -> None:
    """Raise ApplrError unless all words are ARG:=VALUE with a known name, or ROS's own.

    Names of ROS's own arguments begin with an underscore.
    """
    for word in words:
        name, separator, _ = word.partition(":=")
        if not separator or not (name in known or name.startswith("_")):
            advice = f"give ARG:=VALUE with one of {', '.join(known)}"
            raise ApplrError(f"{word} is not an argument: {advice}")


def number_within(name: str, value: Any, low: float = -math.inf, high: float = math.inf) -> float:
    """Return `value` if it is a number from `low` to `high`, otherwise raise ApplrError."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if is_number and low <= value <= high:
        return value  # type: ignore[no-any-return]  # an int stays an int
    requirement = "a number"
    if math.isfinite(high):
        requirement += f" from {low:g} to {high:g}"
    elif math.isfinite(low):
        requirement += f" of at least {low:g}"
    raise ApplrError(f"{name} is {shown(value)}: give {requirement}")


def boolean(name: str, text: str) -> bool:
    """Parse a boolean in the spelling of launch files. Raise ApplrError for any other text."""
    spelling = text.lower()
    if spelling not in ("true", "false", "1", "0"):
        raise ApplrError(f"{name} is {text or 'empty'}: give true or false")
    return spelling in ("true", "1")


def pose(name: str, text: str) -> Pose:
    """Parse "x y yaw", also with commas, into a pose.

    Raise ApplrError unless these are three finite numbers.
    """
    words = text.replace(",", " ").split()
    # A wrong number of words is refused like a number that is not finite.
    try:
        x, y, yaw = map(float, words)
    except ValueError:
        x = y = yaw = math.nan
    if not all(map(math.isfinite, (x, y, yaw))):
        remedy = "give three numbers 'x y yaw' in metres and radians"
        raise ApplrError(f"{name} is {text or 'empty'}: {remedy}")
    return x, y, yaw


def frame_prefix(text: str) -> str:
    """Return the prefix of a robot's frames: "robot1/" for "robot1", "" for "none" or no text."""
    robot_name = text.strip("/")
    if robot_name in ("", "none"):
        return ""
    return f"{robot_name}/"
