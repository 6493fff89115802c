"""Command lines of programs that ROS may start."""

from __future__ import annotations

import math
import os
import sys
from typing import Any, List, Optional, Sequence, Type

from applr_ros1.common.errors import ApplrError


def without_remappings(arguments: Optional[Sequence[str]] = None) -> List[str]:
    """A command line (sys.argv's if None) without ROS's remapping arguments (NAME:=VALUE), as rospy.myargv does."""
    return [word for word in (sys.argv[1:] if arguments is None else arguments) if ":=" not in word]


def number_within(
    name: str, value: Any, low: float = -math.inf, high: float = math.inf, error: Type[ApplrError] = ApplrError
) -> float:
    """A parameter's value, if it is a number from `low` to `high` (infinite only where a bound is); else `error`."""
    if not isinstance(value, bool) and isinstance(value, (int, float)) and low <= value <= high:
        return value
    between = "" if math.isinf(low) and math.isinf(high) else " from %g to %g" % (low, high)
    raise error("%s is %r: give a number%s" % (name, value, between))


def check_new_bag(path: str, error: Type[ApplrError]) -> None:
    """Raises `error` where the bag `record` names, or rosbag's unfinished PATH.active, is there already."""
    for there, what in ((path, "it"), (path + ".active", path + ".active")):
        if os.path.lexists(there):
            raise error("record is %s: %s is there already; give another name" % (path, what))
