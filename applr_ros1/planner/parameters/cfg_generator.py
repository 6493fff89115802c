"""Generator of the dynamic_reconfigure configuration of one server.

Called by the files in applr_ros1/cfg while catkin builds the package, under ROS's interpreter and
without numpy.
"""

from __future__ import annotations

import math
from typing import Any, Optional

from applr_ros1.planner.parameters.declarations import SERVERS
from applr_ros1.planner.parameters.layers import TYPES
from applr_ros1.planner.parameters.parameter import Parameter


def generate(server: str, node: str, name: str) -> Optional[int]:
    """Write the type `name`Config with the parameters of a server, and return the exit status.

    server: name of a server or type of a layer. node: name of the node.
    """
    # Only the ROS of the catkin workspace has this module.
    from dynamic_reconfigure import parameter_generator_catkin as catkin

    types = {
        "double": catkin.double_t,
        "int": catkin.int_t,
        "bool": catkin.bool_t,
        "str": catkin.str_t,
    }
    # All layers of a type share one generated type, whatever their names.
    parameters = TYPES[server].live if server in TYPES else SERVERS[server]
    generator = catkin.ParameterGenerator()
    for p in parameters:
        doc = p.about
        if p.unit:
            doc += f" Unit: {p.unit}."
        edit_method = ""
        if p.enum:
            choices = [generator.const(key, catkin.int_t, *rest) for key, *rest in p.enum]
            edit_method = generator.enum(choices, doc)
        for key in p.names:
            text = doc
            if key != p.name:
                text = f"Older name of {p.name}; both always have the same value."
            generator.add(
                key,
                types[p.type],
                0,
                text,
                p.default,
                _bound(p, p.min),
                _bound(p, p.max),
                edit_method,
            )
    status: Optional[int] = generator.generate("applr_ros1", node, name)
    return status


def _bound(p: Parameter, bound: Any) -> Any:
    """Return a bound of a parameter, or None if it is infinite: the generator knows no infinity."""
    if p.type in ("double", "int") and math.isfinite(bound):
        return bound
    return None
