"""README.md's tables of parameters, made from parameters.py: `python -m applr_ros1.planner.parameters.table README.md`
writes them between the file's two marks. A test checks that the README holds what this makes. Standard library only.
"""

from __future__ import annotations

import math
import sys

from applr_ros1.planner.parameters.declarations import SERVERS, STATIC, Parameter

BEGIN, END = "<!-- parameters: made by parameter_table.py -->", "<!-- end of parameters -->"
HEAD = "| parameter | type | range | default | Jackal | unit | what it does |\n|---|---|---|---|---|---|---|"
TITLES = {
    "": "`/move_base`",
    "TrajectoryPlannerROS": "`/move_base/TrajectoryPlannerROS`",
    "local_costmap": "`/move_base/local_costmap` and `/move_base/global_costmap`",
    "local_costmap/inflater_layer": "`.../inflater_layer` of both costmaps",
    "local_costmap/obstacles_layer": "`.../obstacles_layer` of both costmaps",
}
STATIC_TITLES = dict(
    TITLES,
    NavfnROS="`/move_base/NavfnROS`",
    **{"local_costmap/obstacles_layer/scan": "`.../obstacles_layer/scan` of both costmaps"},
)


def tables() -> str:
    """Markdown: a table for every dynamic_reconfigure server, then one for what is read only at start-up."""
    parts = [
        BEGIN,
        "",
        "Live, through dynamic_reconfigure. The costmaps' rows show the local one; the Jackal's",
        "global one is 40 x 40 m, from (-20, -20) on.",
        "",
    ]
    for server, title in TITLES.items():
        rows = [_row(p) for p in SERVERS[server] if p.name != "restore_defaults"]
        parts += ["**%s**" % title, "", HEAD] + rows + [""]
    parts += ["Read once, when the node starts:", ""]
    for server, title in STATIC_TITLES.items():
        if server not in STATIC:
            continue
        parts += ["**%s**" % title, "", HEAD] + [_row(p) for p in STATIC[server]] + [""]
    return "\n".join(parts + [END])


def _row(p: Parameter) -> str:
    names = " / ".join("`%s`" % name for name in (p.name,) + p.aliases)
    bounds = "" if p.type in ("bool", "str", "list") else "%s to %s" % (_number(p.min), _number(p.max))
    return "| %s | %s | %s | %s | %s | %s | %s |" % (
        names,
        p.type,
        bounds,
        _value(p.default),
        _value(p.value),
        p.unit,
        p.doc,
    )


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
        return ", ".join(str(entry.get("name", entry)) for entry in value) or "empty"
    return "`%s`" % value if value else "empty"


def write(path: str) -> None:
    """Put the tables between the marks of a Markdown file. ValueError where it has no marks."""
    with open(path, encoding="utf-8") as file:
        text = file.read()
    if BEGIN not in text or END not in text:
        raise ValueError("%s has no place for the tables: give it the lines %s and %s" % (path, BEGIN, END))
    before, after = text[: text.index(BEGIN)], text[text.index(END) + len(END) :]
    with open(path, "w", encoding="utf-8") as file:
        file.write(before + tables() + after)


if __name__ == "__main__":
    try:
        write(*sys.argv[1:2] or ["README.md"])
    except (OSError, ValueError) as problem:
        sys.exit("parameter_table: %s" % problem)
