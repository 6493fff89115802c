"""Differences between the settings of a command and those of the table in its folder, in words."""

from __future__ import annotations

from typing import Any, Mapping

from applr_ros1.common.errors import shown


def difference(folder: Any, stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return in one line what differs first and what to do, or "" if nothing differs.

    Args:
        folder: Folder of the table.
        stored: Settings of the table, as JSON values.
        wanted: Settings of the command, as JSON values. Others in the table do not count.
    """
    for setting, value in wanted.items():
        change = _first_change(setting, stored.get(setting), value)
        if change:
            return f"{folder} was driven otherwise, {change}: give another --out"
    return ""


def _first_change(name: str, old: Any, new: Any) -> str:
    """Return the first value that differs in words, with its dotted name; "" if none does."""
    if isinstance(old, dict) and isinstance(new, dict):
        for part in dict.fromkeys((*old, *new)):
            change = _first_change(f"{name}.{part}", old.get(part), new.get(part))
            if change:
                return change
        return ""
    if old == new:
        return ""
    return f"with {name} {shown(old)}, not {shown(new)}"
