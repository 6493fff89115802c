"""Declaration of one parameter of move_base, with short constructors for the tables of this folder.

Used by the tables (move_base_parameters.py and its neighbours) and by their readers. Uses only the standard library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Iterable, Iterator, Optional, Tuple

from applr_ros1.common.errors import ApplrError

INF = math.inf
INT_MAX = 2147483647
MOST_POINTS = 100_000  # largest number of points of one trajectory or turn; more would take minutes
TEXT_OR_LIST = ("footprint", "y_vels")  # texts that parameter files may also give as lists
# Users that read a parameter only at start-up (Parameter.once): TrajectoryPlannerROS for all its cycles; both local
# planners; TrajectoryPlannerROS for stopping and turning at its goal; the recovery behaviours
OUTLINE, PERIOD, GOAL, RECOVERY = (
    "TrajectoryPlannerROS",
    "the local planner",
    "the stop and turn at a goal",
    "recovery",
)
_TYPES = {"bool": bool, "str": str, "list": list}
_GIVE = {
    "double": "a finite number",
    "int": "a whole number",
    "bool": "true or false",
    "str": "text",
    "list": "a list",
}


class ParameterError(ApplrError):
    """Invalid name or value of a parameter; the message is one line with the remedy."""


@dataclass(frozen=True)
class Parameter:
    """Declaration of one parameter, as in the C++ node, with a description.

    Attributes:
        name: name in ROS.
        type: "double", "int", "bool" or "str" as in dynamic_reconfigure; "list" only for parameters that are read once.
        default, min, max: values of this type.
        unit: unit; "" for none.
        doc: description in one or two sentences.
        aliases: older names that always have the same value.
        enum: (name, value, description) of each choice.
        not_zero: whether 0 is rejected although it lies within the bounds.
        beyond: report about a start-up value out of bounds, which is clamped as in C++: "remark" (warning), "" (none),
            or "error" if the robot cannot drive with the clamped value.
        kind: quantity, from which the range of a learned parameter and the limit of a base follow: "speed" or "turn" of
            the base, "length", "1/length", "time", "count" of samples, "weight" of a distance, or "" for others.
        older: names that the C++ node no longer reads.
        once: users that read the parameter only when move_base starts, so that a reconfigure does not affect them.
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
    beyond: str = "remark"
    kind: str = ""
    older: Tuple[str, ...] = ()
    once: Tuple[str, ...] = ()

    @property
    def about(self) -> str:
        """Description, with the users that read the parameter only once."""
        users = " and ".join(self.once)
        return f"{self.doc} For {users} the value at start-up applies." if users else self.doc

    @property
    def names(self) -> Tuple[str, ...]:
        """Name, followed by the aliases."""
        return (self.name, *self.aliases)

    @property
    def give(self) -> str:
        """Remedy for a value of another type, as the end of a message."""
        return f"give {_GIVE[self.type]}"

    def reads(self, value: Any) -> bool:
        """Return whether roscpp reads `value`. roscpp ignores values of another type and uses the default."""
        if self.type in ("double", "int"):
            return isinstance(value, (int, float)) and not isinstance(value, bool)
        return isinstance(value, (str, list) if self.name in TEXT_OR_LIST else _TYPES[self.type])

    def convert(self, value: Any, label: str = "") -> Any:
        """Convert `value` without clamping. Raise ParameterError for another type, NaN, infinity or an invalid 0."""
        label = label or self.name
        number = self.type in ("double", "int")
        if not self.reads(value) or number and not math.isfinite(value):
            raise ParameterError(f"{label} is {value!r}: {self.give}")
        if not number:
            return str(value) if self.type == "str" else value
        if self.not_zero and value == 0:
            raise ParameterError(f"{label} is 0: give a number above 0")
        return (
            float(value) if self.type == "double" else math.floor(value + 0.5)
        )  # roscpp rounds, too.

    def taken(self, value: Any, label: str = "") -> Any:
        """Return `value` as the node uses it: converted and clamped. Raise ParameterError like `convert`."""
        return self.clamp(self.convert(value, label), label)

    def clamp(self, value: Any, label: str = "") -> Any:
        """Clamp `value` to the bounds. Raise ParameterError if the result is 0 although not_zero is set."""
        if self.type not in ("double", "int"):
            return value
        moved = min(max(value, self.min), self.max)
        if self.not_zero and moved == 0:
            raise ParameterError(f"{label or self.name} is {value!r}: give a number above 0")
        return moved


def too_many_points(
    values: Dict[str, Any], spacing: str, names: Iterable[str], time: Optional[float] = None
) -> Iterator[str]:
    """Yield a message for the first of the named values that has too many points at the spacing `values[spacing]`.

    The values are lengths, or speeds if a time [s] is given.
    """
    for name in names:
        if abs(values[name]) * (1.0 if time is None else time) > MOST_POINTS * values[spacing]:
            what = f"{name} {values[name]:g}" + (
                "" if time is None else f" and sim_time {time:g} s"
            )
            yield f"{spacing} is {values[spacing]:g}: more than {MOST_POINTS} points with {what}, give a larger value"
            return


def real(
    name: str, default: Any, low: float, high: float, unit: str, doc: str, **more: Any
) -> Parameter:
    """Declare a double."""
    return Parameter(name, "double", default, low, high, unit, doc, **more)


def whole(
    name: str, default: Any, low: float, high: float, unit: str, doc: str, **more: Any
) -> Parameter:
    """Declare an int."""
    return Parameter(name, "int", default, low, high, unit, doc, **more)


def flag(name: str, default: Any, doc: str, **more: Any) -> Parameter:
    """Declare a bool."""
    return Parameter(name, "bool", default, False, True, "", doc, **more)


def text(name: str, default: Any, doc: str, **more: Any) -> Parameter:
    """Declare a str."""
    return Parameter(name, "str", default, "", "", "", doc, **more)


def listing(name: str, default: Any, doc: str) -> Parameter:
    """Declare a list, read once when the node starts."""
    return Parameter(name, "list", default, None, None, "", doc)


RESTORE = flag(
    "restore_defaults", False, "Restores all parameters of this server to their start-up values."
)
