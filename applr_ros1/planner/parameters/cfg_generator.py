"""Generator of the dynamic_reconfigure configuration of one server.

Called by the files in applr_ros1/cfg while catkin builds the package, under ROS's interpreter and without numpy.
"""

from __future__ import annotations

import math
from typing import Optional

from applr_ros1.planner.parameters.declarations import SERVERS
from applr_ros1.planner.parameters.layers import TYPES


def generate(server: str, node: str, name: str) -> Optional[int]:
    """Write the type `name`Config with the parameters of `server`, a server or layer type; return the exit status."""
    from dynamic_reconfigure import parameter_generator_catkin as catkin

    types = {
        "double": catkin.double_t,
        "int": catkin.int_t,
        "bool": catkin.bool_t,
        "str": catkin.str_t,
    }
    generator = catkin.ParameterGenerator()
    for p in TYPES[server].live if server in TYPES else SERVERS[server]:
        bounds = [
            v if p.type in ("double", "int") and math.isfinite(v) else None for v in (p.min, p.max)
        ]
        doc = p.about + (f" Unit: {p.unit}." if p.unit else "")
        choices = [generator.const(n, catkin.int_t, v, d) for n, v, d in p.enum]
        edit = generator.enum(choices, doc) if choices else ""
        for key in p.names:
            text = (
                doc
                if key == p.name
                else f"Older name of {p.name}; both always have the same value."
            )
            generator.add(key, types[p.type], 0, text, p.default, bounds[0], bounds[1], edit)
    status: Optional[int] = generator.generate("applr_ros1", node, name)
    return status
