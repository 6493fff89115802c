"""What a value in robot.yaml may be: numbers within bounds, choices, names, vectors; each takes a value or refuses it.

description.py declares its fields with them, reader.py and space_section.py apply them.
"""

from __future__ import annotations

import re
from dataclasses import MISSING, field
from typing import Any, Callable, Dict, Sequence, Tuple

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError

ROS_NAME = re.compile(r"/?[A-Za-z]\w*(/\w+)*", re.ASCII)
Take = Callable[[Any, str], Any]  # (value, label) -> the value converted; ApplrError


def real(low: float, high: float, default: Any = MISSING) -> Any:
    """A field that holds a finite number from low to high."""
    return _field(number(low, high), default)


def whole(low: int, high: int) -> Any:
    """A field that holds a whole number from low to high."""

    def take(value: Any, label: str) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ApplrError(f"{label} is {shown(value)}: give a whole number from {low} to {high}")
        return value

    return _field(take)


def choice(*names: str, default: Any = MISSING) -> Any:
    """A field that holds one of some words."""

    def take(value: Any, label: str) -> str:
        if value not in names:
            raise ApplrError(f"{label} is {shown(value)}: give {' or '.join(names)}")
        return value

    return _field(take, default)


def ros_name(default: Any = MISSING) -> Any:
    """A field that holds the name of a topic or frame."""

    def take(value: Any, label: str) -> str:
        if not isinstance(value, str) or not ROS_NAME.fullmatch(value):
            raise ApplrError(f"{label} is {shown(value)}: give a name such as front/scan")
        return value

    return _field(take, default)


def vector(count: int, low: float, high: float, default: Any = MISSING) -> Any:
    """A field that holds `count` numbers from low to high, as a tuple."""
    return _field(_items(number(low, high), count, count, f"{count} numbers"), default)


def points(default: Any = MISSING) -> Any:
    """A field that holds up to eight points [x, y] within 10 m, as a tuple of tuples."""
    point = _items(number(-10.0, 10.0), 2, 2, "2 numbers")
    return _field(_items(point, 0, 8, "at most eight points [x, y]"), default)


def number(low: float, high: float) -> Take:
    """Takes a number from low to high as a float."""
    return lambda value, label: float(number_within(label, value, low, high))


def mapping(value: Any, label: str, known: Sequence[str] = ()) -> Dict[str, Any]:
    """`value` if it is a mapping of the known names (of any where none are given), else ApplrError."""
    if not isinstance(value, dict):
        raise ApplrError(f"{label} is {shown(value)}: give a mapping of names and values")
    unknown = [name for name in value if known and name not in known]
    if unknown:
        raise ApplrError(f"{label + '.' if label else ''}{unknown[0]} is unknown: there are {', '.join(known)}")
    return value


def shown(value: Any) -> str:
    """A value for an error's line, shortened."""
    return f"{value!r:.60}"


def _items(take: Take, least: int, most: int, what: str) -> Take:
    def take_all(value: Any, label: str) -> Tuple[Any, ...]:
        if not isinstance(value, list) or not least <= len(value) <= most:
            raise ApplrError(f"{label} is {shown(value)}: give a list of {what}")
        return tuple(take(item, f"{label}[{i}]") for i, item in enumerate(value))

    return take_all


def _field(take: Take, default: Any = MISSING) -> Any:
    return field(default=default, metadata={"take": take}) if default is not MISSING else field(metadata={"take": take})
