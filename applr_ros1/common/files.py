"""Atomic writing, reading and hashing of files. Every failure is an ApplrError of one line."""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

import yaml

from applr_ros1.common.errors import ApplrError, reason

LONGEST_PROBLEM = 200  # number of characters of a parser's message that are shown

# what TinyXML accepts although it is not XML
NAMESPACE = re.compile(r"""\sxmlns\s*=\s*("[^"<>]*"|'[^'<>]*')""")  # a default namespace
BARE_AMPERSAND = re.compile(r"&(?!#?\w+;)")  # & that begins no entity
BOUND_PREFIX = re.compile(r"\bxmlns:([\w.-]+)")  # declaration of a prefix
PREFIXED_TAG = re.compile(r"(</?)([\w.-]+):(?=\w)")  # beginning of a tag with a prefix
DECLARATION = re.compile(r"<\?xml\b[^<>]*>")


def write_bytes(path: Any, data: bytes) -> None:
    """Write a file atomically: a crash leaves the old file or the new one, never a partial one."""
    if os.path.lexists(path) and not os.path.isfile(path):  # Renaming would replace a device.
        raise ApplrError(f"{path}: a folder, pipe or device; give the path of a regular file")
    partial_path = f"{path}.{os.getpid()}.partial"
    try:
        with open(partial_path, "wb") as partial_file:
            partial_file.write(data)
            # Without fsync, a power failure after the renaming could leave an empty file.
            partial_file.flush()
            os.fsync(partial_file.fileno())
        os.replace(partial_path, path)
    except OSError as problem:
        if os.path.exists(partial_path):
            os.unlink(partial_path)
        failure = f"cannot be written ({reason(problem)}); the file there is untouched"
        raise ApplrError(f"{path}: {failure}") from None


def write_json(path: Any, value: Any) -> None:
    """Write a value as indented JSON, atomically."""
    json_text = json.dumps(value, indent=1) + "\n"
    write_bytes(path, json_text.encode())


def read_bytes(path: Any) -> bytes:
    """Return the content of a file."""
    try:
        return Path(path).read_bytes()
    except OSError as problem:
        failure = f"cannot be read ({reason(problem)}); give an existing file"
        raise ApplrError(f"{path}: {failure}") from None


def read_json(path: Any) -> Any:
    """Return the value in a JSON file."""
    try:
        return json.loads(read_bytes(path))
    except (json.JSONDecodeError, UnicodeDecodeError) as problem:
        failure = f"not JSON ({reason(problem)}); the file is damaged or of another kind"
        raise ApplrError(f"{path}: {failure}") from None


def read_yaml(path: Any) -> Any:
    """Return the plain value in a YAML file. A tag that creates a Python object is an error."""
    return yaml_value(read_bytes(path), path)


def yaml_value(text: Any, name: Any, loader: Any = yaml.SafeLoader) -> Any:
    """Return the value of a YAML text.

    Raises ApplrError if it is invalid; the line begins with `name`.
    """
    try:
        return yaml.load(text, loader)
    except (yaml.YAMLError, ValueError) as error:  # An impossible date or angle is a ValueError.
        problem = " ".join(str(error).split())[:LONGEST_PROBLEM]
        raise ApplrError(f"{name}: not readable as YAML: {problem}") from None


def plain_xml(data: bytes) -> str:
    """Return XML that TinyXML accepts as standard XML.

    TinyXML allows any text before the declaration and in comments, a bare &, and undeclared name
    spaces.
    """
    xml_text = _without_comments(data.decode("utf-8-sig", "replace"))
    xml_text = BARE_AMPERSAND.sub("&amp;", NAMESPACE.sub("", xml_text))

    # <gazebo:plugin> becomes <gazebo_plugin> if no xmlns:gazebo declares the prefix.
    bound_prefixes = set(BOUND_PREFIX.findall(xml_text))

    def without_undeclared_prefix(tag: re.Match[str]) -> str:
        return tag[0] if tag[2] in bound_prefixes else f"{tag[1]}{tag[2]}_"

    xml_text = PREFIXED_TAG.sub(without_undeclared_prefix, xml_text)
    return DECLARATION.sub("", xml_text, count=1).lstrip()


def _without_comments(text: str) -> str:
    """Return XML without comments, with their line breaks, so that errors name the right line."""
    kept_text, *remaining_parts = text.split("<!--")
    for remaining_part in remaining_parts:
        comment, _, following_text = remaining_part.partition("-->")
        kept_text += "\n" * comment.count("\n") + following_text
    return kept_text


def sha256(*values: Any) -> str:
    """Return the hexadecimal SHA-256 of the values in order.

    Bytes are hashed as they are, other values as text.
    """
    encoded_values = []
    for value in values:
        if not isinstance(value, bytes):
            value = str(value).encode()
        encoded_values.append(value)
    return hashlib.sha256(b"\0".join(encoded_values)).hexdigest()
