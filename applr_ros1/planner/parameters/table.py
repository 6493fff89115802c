"""Writes docs/reference/parameters.md from the declarations.

`python -m applr_ros1.planner.parameters.table docs/reference/parameters.md` writes the lists between the file's two
marks. A test checks that the file holds what this makes. Standard library only.
"""

from __future__ import annotations

import math
import sys
import textwrap
from typing import List

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.planner.parameters.declarations import BEHAVIOUR, SERVERS, STATIC, Parameter
from applr_ros1.planner.parameters.layers import TYPES

BEGIN, END = "<!-- begin: written by python -m applr_ros1.planner.parameters.table -->", "<!-- end -->"
WIDTH = 119
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


def tables() -> str:
    """Markdown: a list for every dynamic_reconfigure server, then one for what is read only at start-up."""
    parts = [BEGIN, ""]
    for title, declared in (
        ("Live, through dynamic_reconfigure", dict(SERVERS, **{MAP: TYPES[MAP].live})),
        ("Read once, when the node starts", dict(STATIC, **{MAP: TYPES[MAP].static, NAMED: BEHAVIOUR})),
    ):
        parts += ["## " + title, ""]
        for path in PLACES:
            if path in declared:
                parts += ["### " + PLACES[path], ""]
                for p in declared[path]:
                    parts += _entry(p) if p.name != "restore_defaults" else []
                parts += [""]
    return "\n".join(parts + [END])


def _entry(p: Parameter) -> List[str]:
    """One parameter as an item of a Markdown list, wrapped."""
    older = "".join(", older name `%s`" % name for name in p.aliases)
    unit = " " + p.unit if p.unit else ""
    bounds = "" if p.type in ("bool", "str", "list") else ", %s to %s" % (_number(p.min), _number(p.max))
    what = "%s%s%s; default %s" % (p.type, bounds, unit, _value(p.default))
    text = "- **`%s`**%s (%s). %s" % (p.name, older, what, p.doc)
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


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


def write(path: str) -> None:
    """Put the lists between the marks of a Markdown file. ApplrError where it has no marks."""
    with open(path, encoding="utf-8") as file:
        text = file.read()
    if BEGIN not in text or END not in text:
        raise ApplrError("%s has no place for the lists: give it the lines %s and %s" % (path, BEGIN, END))
    before, after = text[: text.index(BEGIN)], text[text.index(END) + len(END) :]
    with open(path, "w", encoding="utf-8") as file:
        file.write(before + tables() + after)


def main() -> int:
    """Exit status 1 and one line where the file cannot be written."""
    if sys.argv[1:2] in (["-h"], ["--help"]):
        print(
            "usage: python -m applr_ros1.planner.parameters.table [FILE]\n\nWrites the lists of parameters into a "
            "Markdown file, docs/reference/parameters.md by default."
        )
        return 0
    return run_main(lambda: write(*sys.argv[1:2] or ["docs/reference/parameters.md"]), "table")


if __name__ == "__main__":
    sys.exit(main())
