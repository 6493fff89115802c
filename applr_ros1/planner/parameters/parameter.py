"""One parameter of move_base, and short constructors of it for the tables of this folder.

Used by the tables (move_base_parameters.py and its neighbours) and by all that reads them. Pure standard library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Dict, Iterable, Iterator, Optional, Tuple

from applr_ros1.common.errors import ApplrError

INF = math.inf
INT_MAX = 2147483647
MOST_POINTS = 100_000  # of one trajectory or turn; more are refused instead of taking minutes
TEXT_OR_LIST = ("footprint", "y_vels")  # texts that parameter files may give as lists
# who reads a parameter once, when it starts: TrajectoryPlannerROS in all of its cycles, both local planners, what stops
# and turns TrajectoryPlannerROS at its goal, and the recovery behaviours
OUTLINE, PERIOD, GOAL, RECOVERY = "TrajectoryPlannerROS", "the local planner", "turns to a goal's heading", "recovery"
_TYPES = {"bool": bool, "str": str, "list": list}
_GIVE = {"double": "a finite number", "int": "a whole number", "bool": "true or false", "str": "text", "list": "a list"}


class ParameterError(ApplrError):
    """A name or value that cannot be taken; the message is one line with the remedy."""


@dataclass(frozen=True)
class Parameter:
    """One parameter, as the C++ node declares it, with a sentence for a reader.

    name: as in ROS. type: "double", "int", "bool" or "str" as in dynamic_reconfigure; parameters that are read once may
    also be a "list". default, min, max: of that type. unit: "" for none. doc: one or two sentences. aliases: older
    names that always show the same value. older: names that the C++ node has given up and no longer reads.
    kind: "speed" or "turn" that the base is asked for, "length", "1/length", "time", "count" of samples, "weight" of a
    distance; "" for all else. The ranges of learnt parameters and the limits of a base are by kind.
    enum: (name, value, sentence) of each choice. not_zero: 0 lies within the bounds but cannot work and is refused.
    once: who reads it when move_base starts and never again, so that a reconfigure does not reach them.
    beyond: what is said of a start-up value beyond the bounds, which is moved to them as in C++: "remark", "" for
    nothing, or "error" where nothing drives with it.
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
        """Its sentence, and who reads it once."""
        who = " and ".join(self.once)
        return f"{self.doc} For {who} the value at the start of the node counts." if who else self.doc

    @property
    def names(self) -> Tuple[str, ...]:
        """Its name, then the older ones."""
        return (self.name, *self.aliases)

    @property
    def give(self) -> str:
        """What its values are, for people."""
        return f"give {_GIVE[self.type]}"

    def reads(self, value: Any) -> bool:
        """Whether roscpp reads `value`; it passes over one of another type, so that the default counts."""
        if self.type in ("double", "int"):
            return isinstance(value, (int, float)) and not isinstance(value, bool)
        return isinstance(value, (str, list) if self.name in TEXT_OR_LIST else _TYPES[self.type])

    def convert(self, value: Any, label: str = "") -> Any:
        """`value` as its type, bounds aside. ParameterError for another type, NaN, infinity or a useless 0."""
        label = label or self.name
        number = self.type in ("double", "int")
        if not self.reads(value) or number and not math.isfinite(value):
            raise ParameterError(f"{label} is {value!r}: {self.give}")
        if not number:
            return str(value) if self.type == "str" else value
        if self.not_zero and value == 0:
            raise ParameterError(f"{label} is 0, which cannot work: give a number above it")
        return float(value) if self.type == "double" else math.floor(value + 0.5)  # roscpp rounds

    def taken(self, value: Any, label: str = "") -> Any:
        """`value` as the node has it: converted and within the bounds. ParameterError where it cannot be."""
        return self.clamp(self.convert(value, label), label)

    def clamp(self, value: Any, label: str = "") -> Any:
        """`value` moved into the bounds. ParameterError where that makes it a useless 0."""
        if self.type not in ("double", "int"):
            return value
        moved = min(max(value, self.min), self.max)
        if self.not_zero and moved == 0:
            raise ParameterError(f"{label or self.name} is {value!r}, which cannot work: give a number above 0")
        return moved


def too_many_points(
    values: Dict[str, Any], spacing: str, names: Iterable[str], time: Optional[float] = None
) -> Iterator[str]:
    """The first of the values, which is a speed if a time [s] is given, with too many points at `values[spacing]`."""
    for name in names:
        if abs(values[name]) * (1.0 if time is None else time) > MOST_POINTS * values[spacing]:
            what = f"{name} {values[name]:g}" + ("" if time is None else f" and sim_time {time:g} s")
            advice = f"with {what} there are more than {MOST_POINTS} points, give a larger one"
            yield f"{spacing} is {values[spacing]:g}: {advice}"
            return


def real(name: str, default: Any, low: float, high: float, unit: str, doc: str, **more: Any) -> Parameter:
    """Declare a double."""
    return Parameter(name, "double", default, low, high, unit, doc, **more)


def whole(name: str, default: Any, low: float, high: float, unit: str, doc: str, **more: Any) -> Parameter:
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


RESTORE = flag("restore_defaults", False, "Sets all parameters of this server back to the values that it started with.")
