"""The parameters of move_base as Markdown, from applr_ros1/planner/parameters/declarations.py."""

from __future__ import annotations

import math

from applr_ros1.planner.parameters.declarations import SERVERS, STATIC
from applr_ros1.planner.parameters.layers import TYPES
from applr_ros1.planner.parameters.move_base_parameters import BEHAVIOUR
from applr_ros1.planner.parameters.parameter import Parameter

OBSTACLES, INFLATION = "local_costmap/obstacles_layer", "local_costmap/inflater_layer"
MAP = "costmap_2d::StaticLayer"
NAMED = "recovery_behaviors"
PLACES = {
    "": "`/move_base`",
    "TrajectoryPlannerROS": "`/move_base/TrajectoryPlannerROS`",
    "DWAPlannerROS": "`/move_base/DWAPlannerROS`",
    "NavfnROS": "`/move_base/NavfnROS`",
    "local_costmap": "`/move_base/local_costmap` and `/move_base/global_costmap`",
    MAP: "Each static layer (`static_layer` in files without `plugins`)",
    OBSTACLES: "Each obstacle layer (`obstacles_layer` on the Jackal, `obstacle_layer` in files without `plugins`)",
    OBSTACLES + "/scan": "Each source of an obstacle layer (`scan` on the Jackal)",
    INFLATION: "Each inflation layer (`inflater_layer` on the Jackal, `inflation_layer` in files without `plugins`)",
    "conservative_reset": "`/move_base/conservative_reset`",
    "aggressive_reset": "`/move_base/aggressive_reset`",
    "rotate_recovery": "`/move_base/rotate_recovery`",
    NAMED: "Each behaviour that `recovery_behaviors` names",
    "applr": "`/move_base/applr`, which C++ does not have",
}


def parameters() -> str:
    """Markdown: a list for every dynamic_reconfigure server, then one for what is read only at start-up."""
    parts = []
    for title, declared in (
        ("Live, through dynamic_reconfigure", dict(SERVERS, **{MAP: TYPES[MAP].live})),
        ("Read once, when the node starts", dict(STATIC, **{MAP: TYPES[MAP].static, NAMED: BEHAVIOUR})),
    ):
        parts += ["## " + title, ""]
        for path in PLACES:
            if path in declared:
                parts += ["### " + PLACES[path], ""]
                parts += [_entry(p) for p in declared[path] if p.name != "restore_defaults"] + [""]
    return "\n".join(parts)


def _entry(p: Parameter) -> str:
    """One parameter as an item of a Markdown list."""
    older = "".join(", older name `%s`" % name for name in p.aliases)
    unit = " " + p.unit if p.unit else ""
    bounds = "" if p.type in ("bool", "str", "list") else ", %s to %s" % (_number(p.min), _number(p.max))
    what = "%s%s%s; default %s" % (p.type, bounds, unit, _value(p.default))
    return "- **`%s`**%s (%s). %s" % (p.name, older, what, p.doc)


def _number(value) -> str:
    if math.isinf(value) or abs(value) >= 2**31 - 1:
        return "any"
    return "%g" % value


def _value(value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return "%g" % value
    if isinstance(value, list):
        names = [str(entry["name"] if isinstance(entry, dict) else entry) for entry in value]
        return ", ".join(names) or "empty"
    return "`%s`" % value if value else "empty"
