"""Differences between the settings of a command and those of the table in its folder, in words."""

from __future__ import annotations

from typing import Any, Mapping

from training.common.options import dashed

LOADED = ", started with the sets"  # in the setting "planner" of an evaluation with --loaded
# Settings on which others depend, such as the worlds on the robot's size: their words say more.
FIRST = ("robot", "protocol", "planner")
# What a value in the description of a method stands for
_PARTS = {"sha256": "file", "source_sha256": "file", "parameters": "parameter set"}
_CONTENTS = {
    "worlds_with_movers": "the content of the worlds has changed since",
    "worlds_sha256": "the content of the worlds has changed since",
    "world_specs": "the worlds have the same names, but come from other files",
}
OTHER_OUT = "give another --out"


def difference(folder: Any, stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return in one line what differs and what to do, or "" if nothing differs.

    Args:
        folder: Folder of the table.
        stored: Settings of the table, as JSON values.
        wanted: Settings of the command, as JSON values. Others in the table do not count.
    """
    differing = []
    for setting in dict.fromkeys((*FIRST, *wanted)):
        if setting in wanted and wanted[setting] != stored.get(setting):
            differing.append(setting)
    if not differing:
        return ""
    setting = differing[0]
    return _in_words(folder, setting, stored.get(setting), wanted[setting])


def _in_words(folder: Any, setting: str, old: Any, new: Any) -> str:
    """Return the line about a setting that differs."""
    if setting == "methods":
        return _of_methods(folder, old or {}, new)
    if setting == "worlds":
        return f"{folder} has other worlds: {OTHER_OUT}, or the same --worlds"
    if setting == "robot" and isinstance(new, dict):
        old_name = (old or {}).get("name")
        if old_name != new["name"]:
            return f"{folder} has the robot {old_name}, not {new['name']}: {OTHER_OUT}"
        return f"{folder}: the robot {old_name} has changed since: {OTHER_OUT}"
    if setting in _CONTENTS:
        return f"{folder}: {_CONTENTS[setting]}: {OTHER_OUT}"
    if isinstance(old, (bool, int, str)) and isinstance(new, (bool, int, str)):
        old_option = _option(setting, old)
        problem = f"{folder} was driven with {old_option}, not {_option(setting, new)}"
        return f"{problem}: {OTHER_OUT}, or {old_option}"
    return f"{folder}: the setting {setting} has changed since: {OTHER_OUT}"


def _of_methods(folder: Any, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return the line about methods {name: description} that differ."""
    if set(old) != set(new):
        return f"{folder} has the methods {', '.join(old)}: {OTHER_OUT}, or the same --methods"
    for name, description in new.items():
        for value_name in {**description, **old[name]}:
            if description.get(value_name) != old[name].get(value_name):
                part = _PARTS.get(value_name, value_name)
                problem = f"the {part} of method {name} has changed since"
                return f"{folder}: {problem}: {OTHER_OUT}"
    raise AssertionError("the methods are equal")


def _option(setting: str, value: Any) -> str:
    """Return the option with which a command gives this value of a setting."""
    if isinstance(value, bool):
        return dashed(setting) if value else dashed(f"no_{setting}")
    return f"{dashed(setting)} {value}".replace(LOADED, " --loaded")
