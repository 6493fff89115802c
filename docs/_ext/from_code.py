"""Sphinx extension that generates text from the code and the data when the site is built.

A line `<!-- from code: NAME ARGUMENTS -->` of a page is replaced by the Markdown that the function
NAME of this file returns. For complete files, the pages use literalinclude and csv-table.
"""

import contextlib
import importlib
import inspect
import io
import os
import re
import xml.etree.ElementTree as xml
from pathlib import Path
from typing import Any, Dict, Iterable, List, Sequence
from unittest import mock

import pandas as pd

from applr_ros1.planner.parameters.declarations import SERVERS, STATIC
from applr_ros1.planner.parameters.layers import TYPES
from applr_ros1.planner.parameters.move_base_parameters import BEHAVIOUR

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r"^<!-- from code: (\w+) ?(.*) -->$", re.MULTILINE)
MAP, NAMED = "costmap_2d::StaticLayer", "recovery_behaviors"
TITLES = {  # titles of parameters that exist in several places; the others stand below /move_base
    "": "`/move_base`",
    "local_costmap": "`/move_base/local_costmap` and `/move_base/global_costmap`",
    MAP: "Each static layer (`static_layer` in files without `plugins`)",
    "local_costmap/obstacles_layer": (
        "Each obstacle layer (`obstacle_layer` in files without `plugins`)"
    ),
    "local_costmap/obstacles_layer/scan": "Each source of an obstacle layer (`scan` on the Jackal)",
    "local_costmap/inflater_layer": (
        "Each inflation layer (`inflation_layer` in files without `plugins`)"
    ),
    NAMED: "Each behaviour that `recovery_behaviors` names",
    "applr": "`/move_base/applr`, which C++ does not have",
}


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table."""
    lines = [
        head,
        ["---"] * len(head),
        *([str(cell).replace("|", "\\|") for cell in row] for row in rows),
    ]
    return "\n".join("| %s |" % " | ".join(line) for line in lines)


def commands(*modules: str) -> str:
    """Return the output of `python -m MODULE --help` for each module."""
    os.environ["COLUMNS"] = "110"
    parts = []
    for module in modules:
        command, printed = importlib.import_module(module), io.StringIO()
        asked = mock.patch("sys.argv", [module, "--help"])
        captured = contextlib.redirect_stdout(printed)
        with asked, captured, contextlib.suppress(SystemExit):
            command.main()
        ours = re.match(r"usage: (\./applr \w+)", printed.getvalue())
        name = ours.group(1) if ours else "python -m " + module.replace(".__main__", "")
        parts.append("## `%s`\n\n```text\n%s```" % (name, printed.getvalue()))
    return "\n\n".join(parts)


def critics() -> str:
    """Return the table of the critics of DWAPlannerROS."""
    from applr_ros1.planner.dwa.critics.registry import CRITICS

    rows = []
    for critic in CRITICS:
        weight = "`%s`" % critic.term.parameter if critic.scale else "1"
        name = "%s (`%s`)" % (critic.term.title, critic.term.name)
        rows.append([name, weight, critic.value, critic.refuses])
    return table(["critic", "weight", "value", "refuses"], rows)


def faults() -> str:
    """Return the table of faults, with a section for each group."""
    rows = pd.read_csv(ROOT / "docs" / "results" / "faults.csv", dtype=str, keep_default_na=False)
    parts = []
    for group, of_group in rows.groupby("group", sort=False):
        cells = of_group.drop(columns="group").to_numpy()
        parts.append(
            "## %s\n\n%s" % (group, table(["", "fault", "what happens", "measured"], cells))
        )
    return "\n\n".join(parts)


def launch_arguments() -> str:
    """Return a table of the arguments of each launch file."""
    parts = []
    for file in sorted((ROOT / "applr_ros1" / "launch").glob("*.launch")):
        rows = [
            ["`%s`" % arg.get("name"), "`%s`" % arg.get("default", " "), arg.get("doc")]
            for arg in xml.parse(file).iterfind("arg[@doc]")
        ]
        if rows:
            parts.append(
                "## %s\n\n%s" % (file.name, table(["argument", "default", "meaning"], rows))
            )
    return "\n\n".join(parts)


def methods() -> str:
    """Return a table of the named methods."""
    from applr_ros1.policy.methods import METHODS

    return table(["name", "method"], [["`%s`" % name, text] for name, (_, text) in METHODS.items()])


def parameters() -> str:
    """Return the parameters of move_base, a list for each server, then those read at start-up."""
    parts = []
    for title, declared in (
        ("Live, through dynamic_reconfigure", dict(SERVERS, **{MAP: TYPES[MAP].live})),
        (
            "Read once, when the node starts",
            dict(STATIC, **{MAP: TYPES[MAP].static, NAMED: BEHAVIOUR}),
        ),
    ):
        parts += ["## " + title]
        for path in declared:
            if not path.startswith(
                "global_costmap"
            ):  # global_costmap has the parameters of local_costmap
                entries = [_parameter(p) for p in declared[path] if p.name != "restore_defaults"]
                parts += ["### " + TITLES.get(path, "`/move_base/%s`" % path), "\n".join(entries)]
    return "\n\n".join(parts)


def _parameter(p: Any) -> str:
    """Return a declared parameter as an item of a list."""
    older = "".join(", older name `%s`" % name for name in p.aliases)
    ends = [
        "any" if abs(end) >= 2**31 - 1 else "%g" % end
        for end in (p.min, p.max)
        if p.type in ("int", "double")
    ]
    kind = ", ".join([p.type, " to ".join(ends)] if ends else [p.type]) + (
        " " + p.unit if p.unit else ""
    )
    default = "%g" % p.default if isinstance(p.default, (int, float)) else p.default or "empty"
    if isinstance(p.default, bool):
        default = str(p.default).lower()
    elif isinstance(p.default, list):
        default = (
            ", ".join(
                entry["name"] if isinstance(entry, dict) else str(entry) for entry in p.default
            )
            or "empty"
        )
    return "- **`%s`**%s (%s; default `%s`). %s" % (p.name, older, kind, default, p.about)


def robot_sections() -> str:
    """Return the sections of robot.yaml and their fields, from the classes that read them."""
    from applr_ros1.robots.robot import RobotFile

    kinds = {name: field.annotation for name, field in RobotFile.model_fields.items()}
    on_page = "move_base", "parameter_space", "world_scale"  # the page describes these by hand
    return "\n\n".join(_section(name, kind) for name, kind in kinds.items() if name not in on_page)


def _section(name: str, kind: Any) -> str:
    """Return a section of robot.yaml: the class's docstring, and a row for each field."""
    rows = []
    for field, declared in kind.model_json_schema()["properties"].items():
        taken = declared.get("anyOf", [declared])[0]  # the second alternative is null
        item = taken.get("prefixItems", [taken])[0]
        value = " or ".join(item["enum"]) if "enum" in item else item["type"]
        value += ", %g to %g" % (item["minimum"], item["maximum"]) if "minimum" in item else ""
        value = (
            "%d of: %s" % (len(taken["prefixItems"]), value) if "prefixItems" in taken else value
        )
        meaning = declared.get("description", "") + (
            " [%s]" % declared["unit"] if declared.get("unit") else ""
        )
        rows.append(["`%s`" % field, meaning, value, declared.get("default", "required")])
    return "## %s\n\n%s\n\n%s" % (
        name,
        inspect.getdoc(kind),
        table(["field", "meaning", "value", "default"], rows),
    )


def jackal_space() -> str:
    """Return a table of the Jackal's parameter space with the meaning of each parameter."""
    from applr_ros1.policy.parameter_space import SPACE
    from applr_ros1.robots import JACKAL

    rows = []
    for parameter, start in zip(JACKAL.space, SPACE.theta0):
        target = parameter.sets[0]
        meaning = JACKAL.servers[target.server].declared(target.name)
        bounds = "%g to %g" % (parameter.low, parameter.high)
        rows.append(
            ["`%s`" % parameter.name, "%g" % start, bounds, meaning.unit or "", meaning.doc]
        )
    return table(["parameter", "default", "range", "unit", "meaning"], rows)


def _read(app: Any, page: str, source: List[str]) -> None:
    source[0] = MARK.sub(lambda mark: globals()[mark.group(1)](*mark.group(2).split()), source[0])


def setup(app: Any) -> Dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True}
