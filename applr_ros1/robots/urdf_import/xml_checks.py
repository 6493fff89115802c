"""Checks of a URDF's XML, before anything is computed from its links and joints."""

from __future__ import annotations

from typing import Any


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
    ends_of_joints = []
    for joint in joints:
        ends = {tag.get("link") for tag in joint if tag.tag in ("parent", "child")}
        for name in ends.difference(links):
            return f"joint {joint.get('name')} names {name}, which is no link of the file"
        ends_of_joints.append(ends)

    # Links that joints connect to the base, in any number of steps
    root = base_frame if base_frame in links else links[0]
    connected = {root}
    count_before = 0
    while count_before < len(connected):
        count_before = len(connected)
        for ends in ends_of_joints:
            if ends & connected:
                connected |= ends
    loose_links = [link_name for link_name in links if link_name not in connected]
    if loose_links:
        return f"no joint connects {', '.join(loose_links)} to {root}"

    # Connected links with more joints form a ring, or one of them has two parents.
    if len(joints) != len(links) - 1 or len(set(links)) != len(links):
        numbers = f"the {len(links)} links have {len(set(links))} names and {len(joints)} joints"
        return f"{numbers}, but each needs a name of its own and all but the root one joint above"
    return ""
