"""dynamic_reconfigure servers of the move_base node, with the values and checks of MoveBase."""

from __future__ import annotations

import importlib
import threading
from contextlib import suppress
from typing import Any, Dict

import rospy
from dynamic_reconfigure.server import Server

from applr_ros1.planner.move_base import MoveBase


class ReconfigureServer(Server):  # type: ignore[misc]  # ROS packages have no type hints.
    """One dynamic_reconfigure server, in the namespace ~<name>/.

    Args:
        name: Name of the server below the node's name, "" for the node itself.
        move_base: MoveBase that has the values.
        lock: Lock that is held while move_base is used.
    """

    def __init__(self, name: str, move_base: MoveBase, lock: threading.RLock):
        self._name = name
        self._move_base = move_base
        self._lock = lock
        # catkin generates these modules from applr_ros1/cfg.
        config = move_base.servers[name].config
        super().__init__(
            importlib.import_module(f"applr_ros1.cfg.{config}Config"), self._apply, name
        )

    def _apply(self, config: Dict[str, Any], _: int) -> Dict[str, Any]:
        """Apply all values or none, and return the current values."""
        # A configuration has its groups beside the values.
        values = {name: config[name] for name in self.type.defaults}
        try:
            with self._lock:
                in_force = self._move_base.reconfigure(self._name, values)
        except ValueError as problem:
            rospy.logerr("%s refused a change: %s", self.ns, problem)
            raise rospy.ServiceException(str(problem)) from None
        return dict(in_force, groups=config["groups"])

    def _clamp(self, config: Dict[str, Any]) -> None:
        """Leave the values alone: MoveBase clamps them, after a check of their types."""

    def _copy_from_parameter_server(self) -> None:
        # MoveBase has read and checked the values of the parameter server already.
        self.config.update(self._move_base.configuration(self._name))

    def _copy_to_parameter_server(self) -> None:
        with suppress(OSError):  # The values are in force even if the master is down.
            super()._copy_to_parameter_server()
