"""Nested dicts of parameters, as the ROS parameter server holds them."""

from __future__ import annotations

from typing import Any, Dict


def branch(tree: Dict[str, Any], path: str, create: bool = False) -> Dict[str, Any]:
    """Return the dict at a path such as "a/b", or {} if there is none; with `create`, add it to the tree."""
    here: Dict[str, Any] = tree
    for part in filter(None, path.split("/")):
        below = here.setdefault(part, {}) if create else here.get(part)
        if not isinstance(below, dict):
            return {}
        here = below
    return here


def merged(below: Dict[str, Any], above: Dict[str, Any]) -> Dict[str, Any]:
    """Return a new tree: `below` with the values of `above` on top. None does not replace a section of `below`."""
    made = dict(below)
    for name, value in above.items():
        here = made.get(name)
        if isinstance(value, dict):
            made[str(name)] = merged(here if isinstance(here, dict) else {}, value)
        elif value is not None or not isinstance(here, dict):
            made[str(name)] = value
    return made
