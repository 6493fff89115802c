"""Text that is made from the code and the data when the site is built.

A line `<!-- from code: NAME ARGUMENTS -->` of a page becomes the Markdown that the function NAME of this file or of one
that it imports returns.
"""

import csv
import inspect
import re
import subprocess
import xml.etree.ElementTree as xml
from pathlib import Path

from commands import commands
from parameters import parameters

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r"^<!-- from code: (\w+) ?(.*) -->$", re.MULTILINE)


def table(head, rows):
    """A Markdown table; numbers stand right."""
    rows = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    number = re.compile(r"[-+<±]?\s?\d[\d.,]*( .*)?|")
    right = [all(number.fullmatch(row[i]) for row in rows) for i in range(len(head))]
    lines = [head, ["---:" if r else "---" for r in right], *rows]
    return "\n".join("| %s |" % " | ".join(line) for line in lines)


def rows_of(name):
    """The rows of docs/results/NAME.csv as dictionaries."""
    with open(ROOT / "docs" / "results" / (name + ".csv"), encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def csv_table(name):
    """A file of docs/results as it is."""
    rows = rows_of(name)
    return table(list(rows[0]), [row.values() for row in rows])


def comparison(prefix):
    """The summary of docs/results/PREFIX_time.csv, _rates.csv and _faster.csv: a row for each method."""
    rates, faster = ({row["method"]: row for row in rows_of(prefix + end)} for end in ("_rates", "_faster"))
    rows = []
    for row in rows_of(prefix + "_time"):
        rate, won = rates[row["method"]], faster.get(row["method"])
        rows.append(
            [
                "`%s`" % row["method"],
                "%s s (%s)" % (row["time [s]"], row["95 % interval"]),
                "%+.1f %%" % -float(row["faster [%]"]) if won else "",
                rate["success [%]"].split(" ")[0] + " %",
                rate["collided [%]"].split(" ")[0] + " %",
                " / ".join(won[key].split(" ")[0] for key in ("method better", "dwa better")) if won else "",
            ]
        )
    head = ["method", "time (95 % interval)", "than `dwa`", "success", "with a contact", "worlds faster / slower"]
    return table(head, rows)


def faults():
    """The table of faults, in its groups."""
    rows = rows_of("faults")
    parts = []
    for group in dict.fromkeys(row["group"] for row in rows):
        cells = [list(row.values())[1:] for row in rows if row["group"] == group]
        parts += ["## %s\n\n%s" % (group, table(["", "fault", "what happens", "measured"], cells))]
    return "\n\n".join(parts)


def messages():
    """The package's messages and services."""
    files = sorted((ROOT / "msg").glob("*.msg")) + sorted((ROOT / "srv").glob("*.srv"))
    return "\n\n".join("## %s\n\n```text\n%s```" % (file.name, file.read_text(encoding="utf-8")) for file in files)


def launch_arguments():
    """The arguments of each launch file."""
    parts = []
    for file in sorted((ROOT / "applr_ros1" / "launch").glob("*.launch")):
        rows = [
            ["`%s`" % arg.get("name"), "`%s`" % arg.get("default") if arg.get("default") else "", arg.get("doc")]
            for arg in xml.parse(file).getroot().findall("arg")
            if arg.get("doc")
        ]
        parts += ["## %s\n\n%s" % (file.name, table(["argument", "default", "meaning"], rows))] if rows else []
    return "\n\n".join(parts)


def applr_usage():
    """What `./applr --help` prints."""
    printed = subprocess.run([ROOT / "applr", "--help"], capture_output=True, text=True, check=True).stdout
    return "```text\n%s```" % printed


def recipes():
    """The files of training/recipes."""
    files = sorted((ROOT / "training" / "recipes").glob("*.yaml"))
    return "\n\n".join("## %s\n\n```yaml\n%s```" % (file.stem, file.read_text(encoding="utf-8")) for file in files)


def methods():
    """The methods with a name."""
    from applr_ros1.policy.methods.registry import METHODS

    return table(["name", "method"], [["`%s`" % name, text] for name, (_, text) in METHODS.items()])


def robot_sections():
    """The sections of robot.yaml and their fields, from the dataclasses that read them."""
    from applr_ros1.robots import description
    from applr_ros1.robots.reader import RobotFile

    kinds = {name: field.annotation for name, field in RobotFile.model_fields.items()}
    return "\n\n".join(
        _section(name, kind) for name, kind in kinds.items() if getattr(kind, "__module__", "") == description.__name__
    )


def jackal_space():
    """The Jackal's parameter space, with the declared meaning of each parameter."""
    from applr_ros1.planner.parameters.declarations import SERVERS
    from applr_ros1.policy.parameter_space import SPACE
    from applr_ros1.robots import JACKAL

    declared = {name: p for parameters in SERVERS.values() for p in parameters for name in (p.name, *p.aliases)}
    rows = []
    for parameter, start in zip(JACKAL.space, SPACE.theta0):
        meaning = next(declared[name] for name in parameter.settings[0].names if name in declared)
        bounds = "%g to %g" % (parameter.low, parameter.high)
        rows.append(["`%s`" % parameter.name, "%g" % start, bounds, meaning.unit or "", meaning.doc])
    return table(["parameter", "default", "range", "unit", "meaning"], rows)


def _section(name, kind):
    """One section: the class's docstring, which has sentences `field: text.`, and a row for each field."""
    fields = "|".join(kind.model_fields)
    first, *texts = re.split(
        r"(?:^|\s)((?:%s)(?:, (?:%s))*): " % (fields, fields), " ".join(inspect.getdoc(kind).split())
    )
    about = {field: text for names, text in zip(texts[::2], texts[1::2]) for field in names.split(", ")}
    rows = []
    for field, declared in kind.model_json_schema()["properties"].items():
        meaning = "%s [%s]" % (about.get(field, ""), declared["unit"]) if declared.get("unit") else about.get(field, "")
        default = declared.get("default", "required")
        shown = "%g" % default if isinstance(default, float) else str(default or "none")
        shown = "from the shape" if default is None else shown
        rows.append(["`%s`" % field, meaning.strip(), _taken(declared), shown])
    return "## %s\n\n%s\n\n%s" % (name, first, table(["field", "meaning", "value", "default"], rows))


def _taken(declared):
    """What a field takes, from its JSON schema."""
    declared = declared.get("anyOf", [declared])[0]  # the other one is null
    if "enum" in declared:
        return " or ".join(declared["enum"])
    if "prefixItems" in declared:
        items = declared["prefixItems"]
        return "%d numbers, %g to %g" % (len(items), items[0]["minimum"], items[0]["maximum"])
    if declared["type"] == "array":
        return "list of points [x, y]"
    if declared["type"] == "string":
        return "name"
    if declared["type"] == "boolean":
        return "true or false"
    kind = "whole number" if declared["type"] == "integer" else "number"
    return "%s, %g to %g" % (kind, declared["minimum"], declared["maximum"])


FUNCTIONS = {
    f.__name__: f for f in (csv_table, comparison, faults, messages, launch_arguments, applr_usage, recipes, methods)
}
FUNCTIONS.update({f.__name__: f for f in (robot_sections, jackal_space, commands, parameters)})


def _read(app, page, source):
    source[0] = MARK.sub(lambda mark: FUNCTIONS[mark.group(1)](*mark.group(2).split()), source[0])


def setup(app):
    """Called by Sphinx."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True}
