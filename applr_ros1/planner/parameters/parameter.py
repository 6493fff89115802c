"""Declaration of one parameter of move_base, with short constructors for the tables of this folder.

Used by the tables (move_base_parameters.py and its neighbours) and by their readers. Uses only the
standard library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Iterable, Iterator, List, Optional, Tuple

from applr_ros1.common.errors import ApplrError, shown
from applr_ros1.planner.parameters.trees import Values

INF = math.inf
INT_MAX = 2147483647  # bound of dynamic_reconfigure's type int, which has 32 bits
MOST_POINTS = 100_000  # largest number of points of one trajectory or turn; more would take minutes
TEXT_OR_LIST = ("footprint", "y_vels")  # texts that parameter files may also give as lists
# Users that read a parameter only at start-up (Parameter.once)
OUTLINE = "TrajectoryPlannerROS"  # for all its cycles
PERIOD = "the local planner"  # whichever is chosen
GOAL = "the stop and turn at a goal"  # user in TrajectoryPlannerROS
RECOVERY = "recovery"  # the recovery behaviours

_TYPES = {"bool": bool, "str": str, "list": list}
_EXPECTED = {
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
        type: "double", "int", "bool" or "str" as in dynamic_reconfigure; "list" only for parameters
            that are read once.
        default: default value.
        min: lower bound of a number.
        max: upper bound of a number.
        unit: unit; "" for none.
        doc: description in one or two sentences.
        aliases: older names that always have the same value.
        enum: (name, value, description) of each choice.
        not_zero: whether 0 is rejected although it lies within the bounds.
        beyond: report about a start-up value out of bounds, which is clamped as in C++: "remark"
            (warning), "" (none), or "error" if the robot cannot drive with the clamped value.
        kind: quantity, from which the range of a learned parameter and the limit of a base follow:
            "speed" or "turn" of the base, "length", "1/length", "time", "count" of samples,
            "weight" of a distance, or "" for others.
        older: names that the C++ node no longer reads.
        once: users that read the parameter only when move_base starts, so that a reconfigure does
            not affect them.
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
        if not self.once:
            return self.doc
        # Said in .cfg files, pages and tools, where people change values of running robots.
        users = " and ".join(self.once)
        return f"{self.doc} For {users} the value at start-up applies."

    @property
    def names(self) -> Tuple[str, ...]:
        """Name, followed by the aliases."""
        return (self.name, *self.aliases)

    @property
    def give(self) -> str:
        """Remedy for a value of another type, as the end of a message."""
        return f"give {_EXPECTED[self.type]}"

    def reads(self, value: Any) -> bool:
        """Return whether roscpp reads `value`.

        roscpp ignores values of another type and uses the default.
        """
        if self._is_number:  # In Python, True is an int.
            return isinstance(value, (int, float)) and not isinstance(value, bool)
        if self.name in TEXT_OR_LIST:
            return isinstance(value, (str, list))
        return isinstance(value, _TYPES[self.type])

    def given_in(self, section: Values) -> List[Any]:
        """Return the values that a section gives and roscpp reads, the one that counts first."""
        return [section[name] for name in self.names if self.reads(section.get(name))]

    @property
    def _is_number(self) -> bool:
        return self.type in ("double", "int")

    def convert(self, value: Any, label: str = "") -> Any:
        """Convert `value` without clamping.

        Raises:
            ParameterError: `value` has another type, is not finite, or is 0 although not_zero is
                set. The message names it by `label`, or else by the parameter's name.
        """
        label = label or self.name
        # NaN would pass the comparisons with the bounds.
        if not self.reads(value) or (self._is_number and not math.isfinite(value)):
            raise ParameterError(f"{label} is {shown(value)}: {self.give}")
        if self.not_zero and value == 0:
            raise ParameterError(f"{label} is 0: give a number above 0")
        if self.type == "double":
            return float(value)
        if self.type == "int":
            return math.floor(value + 0.5)  # roscpp rounds, too.
        if self.type == "str":
            return str(value)  # A list of TEXT_OR_LIST becomes text.
        return value

    def taken(self, value: Any, label: str = "") -> Any:
        """Return `value` as the node uses it: converted and clamped.

        Raises:
            ParameterError: As in `convert` and `clamp`.
        """
        return self.clamp(self.convert(value, label), label)

    def clamp(self, value: Any, label: str = "") -> Any:
        """Clamp `value` to the bounds.

        Raises:
            ParameterError: The result is 0 although not_zero is set.
        """
        if not self._is_number:
            return value
        # The node divides by these values. A bound of 0 could make a negative value 0.
        clamped = min(max(value, self.min), self.max)
        if self.not_zero and clamped == 0:
            raise ParameterError(f"{label or self.name} is {shown(value)}: give a number above 0")
        return clamped


def by_name(parameters: Iterable[Parameter]) -> Dict[str, Parameter]:
    """Return declarations by name; those with aliases occur under each of their names."""
    declared = {}
    for parameter in parameters:
        declared.update(dict.fromkeys(parameter.names, parameter))
    return declared


def too_many_points(
    values: Dict[str, Any], spacing: str, names: Iterable[str], time: Optional[float] = None
) -> Iterator[str]:
    """Yield a message for the first of the named values that has too many points.

    Args:
        values: all values of the section {name: value}.
        spacing: name of the distance between two points.
        names: names of the values, which are lengths, or speeds if a time is given.
        time: duration of a trajectory [s].
    """
    for parameter_name in names:
        length = abs(values[parameter_name])
        cause = f"{parameter_name} {values[parameter_name]:g}"
        if time is not None:
            length *= time
            cause += f" and sim_time {time:g} s"
        if length > MOST_POINTS * values[spacing]:
            problem = (
                f"{spacing} is {values[spacing]:g}: more than {MOST_POINTS} points with {cause}"
            )
            yield f"{problem}, give a larger value"
            return


def real(
    name: str, default: Any, low: float, high: float, unit: str, doc: str, **options: Any
) -> Parameter:
    """Declare a double."""
    return Parameter(name, "double", default, low, high, unit, doc, **options)


def whole(
    name: str, default: Any, low: float, high: float, unit: str, doc: str, **options: Any
) -> Parameter:
    """Declare an int."""
    return Parameter(name, "int", default, low, high, unit, doc, **options)


def flag(name: str, default: Any, doc: str, **options: Any) -> Parameter:
    """Declare a bool."""
    return Parameter(name, "bool", default, False, True, "", doc, **options)


def text(name: str, default: Any, doc: str, **options: Any) -> Parameter:
    """Declare a str."""
    return Parameter(name, "str", default, "", "", "", doc, **options)


def listing(name: str, default: Any, doc: str) -> Parameter:
    """Declare a list, read once when the node starts."""
    return Parameter(name, "list", default, None, None, "", doc)


RESTORE = flag(
    "restore_defaults", False, "Restores all parameters of this server to their start-up values."
)
