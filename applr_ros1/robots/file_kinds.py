"""Kinds of files that are given by mistake in the place of a URDF or a parameter file."""

from __future__ import annotations

import re

from applr_ros1.common.files import plain_xml

URDF = "a URDF"
# Kinds of XML files by the tag of their root
_XML_KINDS = {"launch": "a launch file", "robot": URDF, "sdf": "a world or model of Gazebo"}
_PRINTED_PARAMETER = re.compile(r"^ \* /\S+: ", re.MULTILINE)  # as roslaunch prints it


def kind_of(content: bytes) -> str:
    """Return the kind of a file that is no YAML, such as "a launch file"; "" if it may be YAML."""
    root = re.match(r"<([\w:.-]+)", plain_xml(content))
    if root:
        return _XML_KINDS.get(root[1], f"an XML file with the root <{root[1]}>")
    if _PRINTED_PARAMETER.search(content.decode("utf-8", "replace")):
        return "the list that roslaunch prints, which cuts off long values"
    return ""
