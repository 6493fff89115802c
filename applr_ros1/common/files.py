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
    partial = f"{path}.{os.getpid()}.partial"
    try:
        with open(partial, "wb") as file:
            file.write(data)
            # Without fsync, a power failure after the renaming could leave an empty file.
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as problem:
        if os.path.exists(partial):
            os.unlink(partial)
        failure = f"cannot be written ({reason(problem)}); the file there is untouched"
        raise ApplrError(f"{path}: {failure}") from None


def write_json(path: Any, value: Any) -> None:
    """Write a value as indented JSON, atomically."""
    text = json.dumps(value, indent=1) + "\n"
    write_bytes(path, text.encode())


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
    text = _without_comments(data.decode("utf-8-sig", "replace"))
    text = BARE_AMPERSAND.sub("&amp;", NAMESPACE.sub("", text))

    # <gazebo:plugin> becomes <gazebo_plugin> if no xmlns:gazebo declares the prefix.
    bound = set(BOUND_PREFIX.findall(text))

    def without_undeclared_prefix(tag: re.Match[str]) -> str:
        return tag[0] if tag[2] in bound else f"{tag[1]}{tag[2]}_"

    text = PREFIXED_TAG.sub(without_undeclared_prefix, text)
    return DECLARATION.sub("", text, count=1).lstrip()


def _without_comments(text: str) -> str:
    """Return XML without comments, with their line breaks, so that errors name the right line."""
    kept, *parts = text.split("<!--")
    for part in parts:
        comment, _, following = part.partition("-->")
        kept += "\n" * comment.count("\n") + following
    return kept


def sha256(*values: Any) -> str:
    """Return the hexadecimal SHA-256 of the values in order.

    Bytes are hashed as they are, other values as text.
    """
    parts = [value if isinstance(value, bytes) else str(value).encode() for value in values]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()
