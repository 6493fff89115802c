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
    for parameter in parameters:
        description = parameter.about
        if parameter.unit:
            description += f" Unit: {parameter.unit}."
        edit_method = ""
        if parameter.enum:
            choices = []
            for choice_name, number, explanation in parameter.enum:
                choices.append(generator.const(choice_name, catkin.int_t, number, explanation))
            edit_method = generator.enum(choices, description)
        for parameter_name in parameter.names:
            entry_text = description
            if parameter_name != parameter.name:
                entry_text = f"Older name of {parameter.name}; both always have the same value."
            generator.add(
                parameter_name,
                types[parameter.type],
                0,
                entry_text,
                parameter.default,
                _bound(parameter, parameter.min),
                _bound(parameter, parameter.max),
                edit_method,
            )
    status: Optional[int] = generator.generate("applr_ros1", node, name)
    return status


def _bound(parameter: Parameter, bound: Any) -> Any:
    """Return a bound of a parameter, or None if it is infinite: the generator knows no infinity."""
    if parameter.type in ("double", "int") and math.isfinite(bound):
        return bound
    return None
