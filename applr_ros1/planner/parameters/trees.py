"""Nested dicts of parameters, as the ROS parameter server holds them."""

from __future__ import annotations

from typing import Any, Dict, Mapping

Tree = Dict[str, Any]  # nested parameters, or a section of them
Values = Mapping[str, Any]  # {name: value} of a section or a server, which nobody changes


def branch(tree: Tree, path: str, create: bool = False) -> Tree:
    """Return the dict at a path such as "a/b".

    If there is none, the result is {}, which is part of the tree only with `create`.
    """
    section: Tree = tree
    for section_name in filter(None, path.split("/")):
        # An empty section of a YAML file is None.
        if create and section.get(section_name) is None:
            section[section_name] = {}
        subsection = section.get(section_name)
        if not isinstance(subsection, dict):
            return {}
        section = subsection
    return section


def without_empty(tree: Tree) -> Tree:
    """Return a tree without values and sections that are None, as empty ones of YAML files are."""
    kept = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            kept[name] = without_empty(value)
        elif value is not None:
            kept[name] = value
    return kept


def merged(below: Tree, above: Tree) -> Tree:
    """Return a new tree: `below` with the values of `above` on top.

    None does not replace a section of `below`: it is what an empty section of a YAML file gives.
    """
    tree = dict(below)
    for name, value in above.items():
        replaced_value: Any = tree.get(name)
        is_section = isinstance(replaced_value, dict)
        if isinstance(value, dict):
            tree[str(name)] = merged(replaced_value if is_section else {}, value)
        elif value is not None or not is_section:
            tree[str(name)] = value
    return tree
