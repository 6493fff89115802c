"""Writes robot.yaml: a new one from what was found in other files, and measured values into one that is there.

training/new_robot.py calls `robot_yaml`, training/tune_robot.py `write_measured`; folder.py reads the file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple, Type

import yaml

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError, read_bytes, sha256, write_bytes
from applr_ros1.robots.measured import Fields
from applr_ros1.robots.parameter_files import Loader, mapping, read_yaml
from applr_ros1.robots.robot import FILE, Base, Body, Frames, Laser, Monitoring, Section, Simulation, Topics

_MODELS: Dict[str, Type[Section]] = {
    "base": Base,
    "body": Body,
    "laser": Laser,
    "topics": Topics,
    "frames": Frames,
    "monitor": Monitoring,
    "simulation": Simulation,
}

NULL = "tag:yaml.org,2002:null"


def robot_yaml(
    source: str,
    values: Mapping[str, Mapping[str, Any]],
    world_scale: float,
    move_base: Mapping[str, Any],
    hints: Mapping[Tuple[str, str], Tuple[Any, str]],
) -> Tuple[str, List[str]]:
    """The file, and a line for each value that it asks for.

    Args:
        source: What it was made from, for its first line.
        values: What was found, by section and field.
        world_scale: The value of that key.
        move_base: The section of that name.
        hints: (value, where it is from) by (section, field), for what was not found but other values make likely.
    """
    frame = values["frames"]["base"]
    also: Dict[str, Tuple[str, ...]] = {"monitor": ("deceleration", "yaw_deceleration")}  # though they have a default
    also.update(base=("casters",) if values["base"].get("drive") != "skid_steer" else ())
    lines = [
        f"# Made from {source}. Lengths in metres, masses in kg, angles in rad, times in s; places in {frame}, x ahead."
    ]
    missing = []
    for section, model in _MODELS.items():
        found = values.get(section, {})
        asked: Dict[str, Any] = {
            name: declared
            for name, declared in model.model_fields.items()
            if name not in found and (declared.is_required() or name in also.get(section, ()))
        }
        lines += [f"{section}:"] * bool(found or asked)
        lines += [f"  {name}: {_flow(value)}" for name, value in found.items()]
        for name, field in asked.items():
            value, origin = hints.get((section, name), (None, ""))
            proposed, unit = "" if value is None else _flow(value), field.json_schema_extra["unit"]
            about = f"[{unit}] {field.description}" if unit else field.description
            lines.append(f"  # {name}: {proposed}".ljust(34) + f"  # {about}" + (f"; here {origin}" if origin else ""))
            missing.append(f"{section}.{name} {about}" + (f"; {origin} is {proposed}" if origin else ""))
    lines.append(f"world_scale: {_flow(world_scale)}")
    lines.append(
        yaml.safe_dump({"move_base": _rounded(move_base)}, sort_keys=False, default_flow_style=None, width=110)
    )
    return "\n".join(lines), missing


def _flow(value: Any) -> str:
    """A value as it stands behind its name in YAML."""
    return yaml.safe_dump(_rounded(value), default_flow_style=True, width=1000).split("\n...")[0].strip()


def _rounded(value: Any) -> Any:
    """A value with its real numbers cut to five digits, and those next to zero to 0."""
    if isinstance(value, dict):
        return {name: _rounded(below) for name, below in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if abs(value) > 1e-8 else 0.0
    return value


def write_measured(folder: Any, fields: Fields) -> List[str]:
    """Writes measured values into the robot.yaml of a folder, each with a comment that says how it was measured.

    The new text is written only where it holds the old values with the measured ones changed, and nothing else.
    Comments and layout stay where values can be put into the text one by one; otherwise the file is written anew from
    its values, the old one is kept beside it, and a line that is returned says so.

    Raises:
        StorageError: The file is not one of sections, or cannot be read or written. It is untouched then.
    """
    path = Path(folder) / FILE
    old, values = read_bytes(path), read_yaml(path)
    if not all(isinstance(values.get(section) or {}, dict) for section, _ in fields):
        raise StorageError(f"{path}: not sections of values; nothing was written")
    numbers = {place: float(f"{value.value:.4g}") for place, value in fields.items()}
    for (section, name), number in numbers.items():
        values[section] = {**(values.get(section) or {}), name: number}  # a new dict: an alias may be another section
    encoding = "utf-8" if old.isascii() or "\ufffd" not in old.decode("utf-8", "replace") else "latin-1"
    anew = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    kept = path.with_name(f"{FILE}.{sha256(old)[:8]}.bak")
    said = f"{path}: written anew for measured values, without comments and layout; as it was: {kept}"
    for new, lines in ((old.decode(encoding), []), (anew, [said])):
        try:
            for (section, name), value in fields.items():
                new = _with_number(new, section, name, numbers[section, name], value)
            same = mapping(new, path) == values
        except (ApplrError, yaml.YAMLError, AttributeError, ValueError):  # a form that marks do not lead through
            same = False
        if same:
            if lines:
                write_bytes(kept, old)
            write_bytes(path, new.encode("utf-8" if lines else encoding))
            return lines
    raise StorageError(f"{path}: its values cannot be written as YAML again; nothing was written")


def _with_number(text: str, section: str, name: str, number: float, how: Any) -> str:
    """The text with a number put in at its place, by the marks of YAML's nodes, and the section below a comment.

    It may hold other values than it should, or none, where the form is unusual, as with aliases.
    """
    text = re.sub(rf"^# measured: {section}\.{name} .*\n", "", text, flags=re.M)
    root: Any = yaml.compose(text, Loader)
    nodes = {key.value: (key, below) for key, below in root.value}
    key, below = nodes.get(section, (root.value[0][0], None))
    shown = _flow(number)
    if below is None:
        text = _put_first(text, root, f"{section}: {{{name}: {shown}}}")
    elif not below.value or below.tag == NULL:
        text = _replaced(text, (key, below), f"{{{name}: {shown}}}")
    else:
        there = [node for node in below.value if node[0].value == name]
        text = _replaced(text, there[-1], shown) if there else _put_first(text, below, f"{name}: {shown}")
    line = text.rfind("\n", 0, key.start_mark.index) + 1
    return f"{text[:line]}# measured: {section}.{name} {how}\n{text[line:]}"


def _replaced(text: str, node: Tuple[Any, Any], new: str) -> str:
    """The text with another value of a node, which is a key and its value."""
    start, end = node[1].start_mark.index, node[1].end_mark.index
    space = " " * (start == end == node[0].end_mark.index + 1)  # after the colon, where there is no value
    return f"{text[:start]}{space}{new}{text[end:]}"


def _put_first(text: str, mapping: Any, new: str) -> str:
    """The text with a key and its value before the first of a mapping."""
    first = mapping.value[0][0].start_mark
    between = ", " if mapping.flow_style else "\n" + " " * first.column
    return f"{text[: first.index]}{new}{between}{text[first.index :]}"
