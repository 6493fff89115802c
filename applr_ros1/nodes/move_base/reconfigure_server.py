"""The dynamic_reconfigure servers of the move_base node, and the mirror of their values as ROS parameters.

A request is checked and applied by MoveBase.reconfigure, between two cycles: all of it or nothing. The library's own
server lets NaN through and writes thirty ROS parameters, one by one, before it answers.
"""

from __future__ import annotations

import importlib
from functools import partial
from typing import Any, Dict

import rospy
from dynamic_reconfigure.encoding import decode_config, encode_config, encode_description, get_tree
from dynamic_reconfigure.msg import Config, ConfigDescription, GroupState
from dynamic_reconfigure.srv import Reconfigure

from applr_ros1.planner.move_base import MoveBase

from .background import BackgroundThread
from .planner_thread import PlannerThread


def write_parameters(namespace: str, values: Dict[str, Any]) -> None:
    """Write {name: value} to the parameter server below `namespace`, which ends in a slash."""
    for name, value in values.items():
        try:
            rospy.set_param(namespace + name, value)
        except Exception as error:  # the master is away; the values are in force all the same
            rospy.logwarn_throttle(10.0, f"cannot write parameter {namespace}{name}: {error}")


class ReconfigureServer:
    """One dynamic_reconfigure server, under ~<name>/ (the node itself for "").

    Args:
        name: Of the server below the node's, "" for the node's own.
        move_base: Holds the values; used in the planner's thread.
        mirror: Where values are written as ROS parameters: a slow or dead master holds nothing up.
        thread: The planner's thread. Values are published there too, so that they go out in the order in which they
            came into force, whoever changes them.
    """

    def __init__(self, name: str, move_base: MoveBase, mirror: BackgroundThread, thread: PlannerThread):
        kind = importlib.import_module(f"applr_ros1.cfg.{move_base.servers[name].config}Config")
        self.name, self._move_base, self._mirror, self._thread = name, move_base, mirror, thread
        self._ns = rospy.get_name() + "/" + (name + "/" if name else "")
        self._names = set(kind.defaults)
        description = encode_description(kind)
        self._groups = get_tree(description)
        for values in (description.max, description.min, description.dflt):  # C++ names the group there, too
            values.groups = [GroupState(group.name, True, group.id, group.parent) for group in description.groups]
        self._published: Dict[str, Any] = {}
        self._descriptions = self._publisher("parameter_descriptions", ConfigDescription)
        self._descriptions.publish(description)
        self._updates = self._publisher("parameter_updates", Config)
        self._publish(move_base.configuration(name))
        self._service = rospy.Service(self._ns + "set_parameters", Reconfigure, self._set)

    def _publisher(self, topic, kind):
        return rospy.Publisher(self._ns + topic, kind, latch=True, queue_size=10)

    def _encode(self, values: Dict[str, Any]) -> Config:
        return encode_config(dict(values, groups=self._groups))

    def change(self, values: Dict[str, Any]) -> Dict[str, Any]:
        """Apply {name: value} and publish what is in force then, which is returned. Only in the planner's thread.

        Raises:
            ValueError: The values cannot be used; nothing has changed.
        """
        in_force = self._move_base.reconfigure(self.name, values)
        self._publish(in_force)
        return in_force

    def _publish(self, values: Dict[str, Any]) -> None:
        changed = {name: value for name, value in values.items() if self._published.get(name) != value}
        self._published = dict(values)
        self._mirror.post(partial(write_parameters, self._ns, changed))
        self._updates.publish(self._encode(values))

    def _set(self, request):
        values = dict(decode_config(request.config))
        unknown = sorted(set(values) - self._names)
        if unknown:
            rospy.logwarn("%s: no parameter %s; ignored", self._ns, ", ".join(unknown))
        values = {name: value for name, value in values.items() if name in self._names}
        try:
            return self._encode(self._thread.ask(lambda: self.change(values)))
        except ValueError as problem:
            if not rospy.is_shutdown():
                rospy.logerr("%s refused a change: %s", self._ns, problem)
            raise rospy.ServiceException(str(problem)) from None
