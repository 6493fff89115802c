"""Maker of ROS 1 messages for the library rosbags, from fields by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Dict, Mapping

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import applr_ros1
from applr_ros1.drives.columns import SECOND

MESSAGES = Path(applr_ros1.__file__).parents[1] / "msg"  # definitions of this package's messages
# Definitions that rosbags lacks.
DEFINITIONS = {
    "move_base_msgs/msg/MoveBaseResult": "",
    "move_base_msgs/msg/MoveBaseActionResult": (
        "std_msgs/Header header\nactionlib_msgs/GoalStatus status\n"
        "move_base_msgs/MoveBaseResult result\n"
    ),
    "move_base_msgs/msg/RecoveryStatus": (
        "geometry_msgs/PoseStamped pose_stamped\nuint16 current_recovery_number\n"
        "uint16 total_number_of_recoveries\nstring recovery_behavior_name\n"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
}
TIME = "builtin_interfaces/msg/Time"

Build = Callable[[Any], Any]  # returns a field of a message from its value, or None for no value


def nanoseconds(seconds: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return int(round(seconds * SECOND))


class Maker:
    """Makes ROS 1 messages of the types that a drive has."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC)
        for message_type, definition in DEFINITIONS.items():
            self.store.register(get_types_from_msg(definition, message_type))
        self._builds: Dict[str, Dict[str, Build]] = {}  # builders for each type

    def make(self, message_type: str, values: Mapping[str, Any]) -> Any:
        """Return a message with the values {field: value}; other fields are zero or empty.

        A time is given in seconds, and an inner message by its values.

        Raises:
            KeyError: The type has no such field.
        """
        builds = self._builds.get(message_type)
        if builds is None:
            builds = self._builds[message_type] = self._builds_of(message_type)
        unknown_fields = values.keys() - builds.keys()
        if unknown_fields:
            raise KeyError(f"{message_type} has no {', '.join(sorted(unknown_fields))}")
        fields = [build(values.get(name)) for name, build in builds.items()]
        return self.store.types[message_type](*fields)

    def _builds_of(self, message_type: str) -> Dict[str, Build]:
        """Return {field: function that builds it} of a type."""
        if message_type.startswith("applr_ros1/") and message_type not in self.store.types:
            self.register_own()
        _, described_fields = self.store.fielddefs[message_type]
        return {name: self._build(description) for name, description in described_fields}

    def register_own(self) -> None:
        """Let the store know the definitions of this package's messages."""
        for message_name in ("Parameters", "Movers", "Decision"):
            definition = (MESSAGES / f"{message_name}.msg").read_text(encoding="utf-8")
            self.store.register(get_types_from_msg(definition, f"applr_ros1/msg/{message_name}"))

    def _build(self, description: Any) -> Build:
        """Return the function that builds a field of a described type."""
        node_type, detail = description
        if node_type == Nodetype.BASE:
            return _base(detail[0])
        if node_type == Nodetype.NAME:
            return self._inner(detail)
        (element_node_type, element_detail), length = detail
        if element_node_type == Nodetype.NAME:
            element = self._inner(element_detail)
            return lambda values: [element(value) for value in values or ()]
        if element_detail[0] == "string":
            return lambda values: list(values or ())
        return _numbers(element_detail[0], length)

    def _inner(self, message_type: str) -> Build:
        """Return the function that builds an inner message."""
        if message_type == TIME:
            time_class = self.store.types[TIME]
            return lambda seconds: time_class(*divmod(nanoseconds(seconds or 0.0), SECOND))
        return lambda values: self.make(message_type, values or {})


def _base(base_type: str) -> Build:
    """Return the function that builds a text, a switch or a number."""
    empty: Any = 0
    if base_type == "string":
        empty = ""
    elif base_type == "bool":
        empty = False
    elif base_type.startswith("float"):
        empty = 0.0
    return lambda value: empty if value is None else value


def _numbers(base_type: str, length: int) -> Build:
    """Return the function that builds an array of numbers, with `length` zeros if there is none."""

    def build(values: Any) -> np.ndarray:
        if values is None:
            return np.zeros(length, base_type)
        return np.ascontiguousarray(values, base_type)

    return build
