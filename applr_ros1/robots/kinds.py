"""What a value in robot.yaml may be: numbers within bounds, choices, texts, vectors; each takes a value or refuses it.

description.py declares its fields with them, reader.py applies them.
"""

from __future__ import annotations

import math
import re
from dataclasses import MISSING, field
from typing import Any, Callable, Tuple

from applr_ros1.common.errors import ApplrError

ROS_NAME = re.compile(r"/?[A-Za-z]\w*(/\w+)*", re.ASCII)
Take = Callable[[Any, str], Any]  # (value, label) -> the value converted; RobotError


class RobotError(ApplrError):
    """A robot description that cannot be used; one line with what, which value and what to give."""


def real(low: float, high: float, default: Any = MISSING) -> Any:
    """A field that holds a finite number from low to high."""

    def take(value: Any, label: str) -> float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or isinstance(value, float) and not math.isfinite(value):
            raise RobotError("%s is %s: give a number from %g to %g" % (label, shown(value), low, high))
        if not low <= value <= high:
            found = shown(value) if isinstance(value, int) else "%g" % value
            raise RobotError("%s is %s: give a number from %g to %g" % (label, found, low, high))
        return float(value)

    return _field(take, default)


def whole(low: int, high: int) -> Any:
    """A field that holds a whole number from low to high."""

    def take(value: Any, label: str) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise RobotError("%s is %s: give a whole number from %d to %d" % (label, shown(value), low, high))
        return value

    return _field(take, MISSING)


def choice(*names: str) -> Any:
    """A field that holds one of some words."""

    def take(value: Any, label: str) -> str:
        if value not in names:
            raise RobotError("%s is %s: give %s" % (label, shown(value), " or ".join(names)))
        return value

    return _field(take, MISSING)


def ros_name(default: Any = MISSING) -> Any:
    """A field that holds the name of a topic or frame."""

    def take(value: Any, label: str) -> str:
        if not isinstance(value, str) or not ROS_NAME.fullmatch(value):
            raise RobotError("%s is %s: give a name such as front/scan" % (label, shown(value)))
        return value

    return _field(take, default)


def vector(count: int, low: float, high: float, default: Any = MISSING) -> Any:
    """A field that holds `count` numbers from low to high, as a tuple."""

    def take(value: Any, label: str) -> Tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise RobotError("%s is %s: give a list of %d numbers" % (label, shown(value), count))
        one = real(low, high).metadata["take"]
        return tuple(one(number, "%s[%d]" % (label, i)) for i, number in enumerate(value))

    return _field(take, default)


def points(default: Any = MISSING) -> Any:
    """A field that holds up to eight points [x, y] within 10 m, as a tuple of tuples."""

    def take(value: Any, label: str) -> Tuple[Tuple[float, ...], ...]:
        if not isinstance(value, list) or len(value) > 8:
            raise RobotError("%s is %s: give a list of at most eight points [x, y]" % (label, shown(value)))
        one = vector(2, -10.0, 10.0).metadata["take"]
        return tuple(one(point, "%s[%d]" % (label, i)) for i, point in enumerate(value))

    return _field(take, default)


def shown(value: Any) -> str:
    """A value for an error's line, shortened."""
    try:
        found = "empty" if value is None or value == "" else repr(value)
    except ValueError:  # digits beyond what Python prints
        found = "a number of too many digits"
    return found if len(found) <= 60 else found[:57] + "..."


def _field(take: Take, default: Any) -> Any:
    return field(default=default, metadata={"take": take}) if default is not MISSING else field(metadata={"take": take})
