"""Checks of a URDF's XML, before anything is computed from its links and joints."""

from __future__ import annotations

from collections import Counter
from typing import Any, Dict, List


def shape_problem(xml: Any) -> str:
    """Return which collision of a URDF has no shape; "" if all have one."""
    for link in xml.findall("link"):
        for collision in link.findall("collision"):
            if collision.find("geometry/*") is None:
                return f"link {link.get('name')} has a <collision> without a shape"
    return ""


def tree_problem(xml: Any, base_frame: str) -> str:
    """Return why the joints of a URDF do not connect its links to one tree; "" if they do.

    Args:
        xml: Root element of the URDF, which has at least one link.
        base_frame: Link of the base. The message is about what is not connected to it.
    """
    links = [link.get("name") for link in xml.findall("link")]
    joints = xml.findall("joint")
    for tag, names in (("link", links), ("joint", [joint.get("name") for joint in joints])):
        name, count = Counter(names).most_common(1)[0] if names else ("", 0)
        if count > 1:
            return f"{count} {tag}s have the name {name}"

    # A link has one parent.
    parent_of: Dict[str, str] = {}
    for joint in joints:
        ends = {}
        for end in ("parent", "child"):
            tag = joint.find(end)
            ends[end] = "" if tag is None else str(tag.get("link"))
            if ends[end] not in links:
                return f"the {end} of joint {joint.get('name')} is no link of the file: {ends[end]}"
        child = ends["child"]
        if child in parent_of:
            return f"link {child} is the child of two joints"
        parent_of[child] = ends["parent"]

    # Links by the root of their part
    parts: Dict[str, List[str]] = {}
    for link_name in links:
        root = link_name
        for _ in links:
            root = parent_of.get(root, root)
        if root in parent_of:
            return f"the joints above link {link_name} form a ring"
        parts.setdefault(root, []).append(link_name)
    main_root = next(iter(parts))
    for root, part in parts.items():
        if base_frame in part:
            main_root = root
    loose_parts = []
    for root, part in parts.items():
        carried_links = ", ".join(part_link for part_link in part if part_link != root)
        if root != main_root:
            loose_parts.append(f"{root} (with {carried_links})" if carried_links else root)
    if loose_parts:
        return f"no joint connects {', '.join(loose_parts)} to {main_root}"
    return ""
