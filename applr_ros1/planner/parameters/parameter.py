"""One parameter of move_base, and short constructors of it for the tables of this folder.

Used by the tables (move_base_parameters.py and its neighbours) and by all that reads them. Pure standard library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Tuple

from applr_ros1.common.errors import ApplrError

INF = math.inf
INT_MAX = 2147483647


@dataclass(frozen=True)
class Parameter:
    """One parameter, as the C++ node declares it, with a sentence for a reader.

    name: as in ROS. type: "double", "int", "bool" or "str" as in dynamic_reconfigure; parameters that are read once may
    also be a "list". default, min, max: of that type. unit: "" for none. doc: one or two sentences. aliases: older
    names that always show the same value.
    enum: (name, value, sentence) of each choice. not_zero: 0 lies within the bounds but cannot work and is refused.
    clamps: a start-up value beyond the bounds is moved to them, as the C++ node does, instead of being refused.
    """

    name: str
    type: str
    default: Any
    min: Any
    max: Any
    unit: str
    doc: str
    aliases: Tuple[str, ...] = ()
    enum: Tuple[Tuple[str, int, str], ...] = ()
    not_zero: bool = False
    clamps: bool = False


class ParameterError(ApplrError):
    """A name or value that cannot be taken; the message is one line with the remedy."""


def real(name: str, default: Any, low: float, high: float, unit: str, doc: str, **more: Any) -> Parameter:
    """Declare a double."""
    return Parameter(name, "double", default, low, high, unit, doc, **more)


def whole(name: str, default: Any, low: float, high: float, unit: str, doc: str, **more: Any) -> Parameter:
    """Declare an int."""
    return Parameter(name, "int", default, low, high, unit, doc, **more)


def flag(name: str, default: Any, doc: str) -> Parameter:
    """Declare a bool."""
    return Parameter(name, "bool", default, False, True, "", doc)


def text(name: str, default: Any, doc: str) -> Parameter:
    """Declare a str."""
    return Parameter(name, "str", default, "", "", "", doc)


def listing(name: str, default: Any, doc: str) -> Parameter:
    """Declare a list, read once when the node starts."""
    return Parameter(name, "list", default, None, None, "", doc)


RESTORE = flag("restore_defaults", False, "Sets all parameters of this server back to the values that it started with.")
