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


def write_bytes(path: Any, data: bytes) -> None:
    """Write a file atomically: a crash leaves the old file or the new one, never a partial one."""
    if os.path.lexists(path) and not os.path.isfile(path):  # Renaming would replace a device.
        raise ApplrError(f"{path}: a folder, pipe or device; give the path of a regular file")
    partial = f"{path}.{os.getpid()}.partial"
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as problem:
        if os.path.exists(partial):
            os.unlink(partial)
        raise ApplrError(f"{path}: cannot be written ({reason(problem)}); the file there is untouched") from None


def write_json(path: Any, value: Any) -> None:
    """Write a value as indented JSON, atomically."""
    write_bytes(path, (json.dumps(value, indent=1) + "\n").encode())


def read_bytes(path: Any) -> bytes:
    """Return the content of a file."""
    try:
        return Path(path).read_bytes()
    except OSError as problem:
        raise ApplrError(f"{path}: cannot be read ({reason(problem)}); give an existing file") from None


def read_json(path: Any) -> Any:
    """Return the value in a JSON file."""
    try:
        return json.loads(read_bytes(path))
    except (json.JSONDecodeError, UnicodeDecodeError) as problem:
        raise ApplrError(f"{path}: not JSON ({reason(problem)}); the file is damaged or of another kind") from None


def read_yaml(path: Any) -> Any:
    """Return the plain value in a YAML file. A tag that would create a Python object is an error."""
    return yaml_value(read_bytes(path), path)


def yaml_value(text: Any, name: Any, loader: Any = yaml.SafeLoader) -> Any:
    """Return the value of a YAML text. Raises ApplrError if it is invalid; the line begins with `name`."""
    try:
        return yaml.load(text, loader)
    except (yaml.YAMLError, ValueError) as error:  # An impossible date or angle is a ValueError.
        raise ApplrError(f"{name}: not readable as YAML: {' '.join(str(error).split())[:200]}") from None


def plain_xml(data: bytes) -> str:
    """Return XML that TinyXML accepts as standard XML.

    TinyXML allows any text before the declaration and in comments, a bare &, and undeclared name spaces.
    """
    first, *others = data.decode("utf-8-sig", "replace").split("<!--")
    parts = (part.partition("-->") for part in others)
    text = first + "".join("\n" * comment.count("\n") + rest for comment, _, rest in parts)
    text = re.sub(r"&(?!#?\w+;)", "&amp;", re.sub(r"""\sxmlns\s*=\s*("[^"<>]*"|'[^'<>]*')""", "", text))
    bound = set(re.findall(r"\bxmlns:([\w.-]+)", text))
    text = re.sub(r"(</?)([\w.-]+):(?=\w)", lambda tag: tag[0] if tag[2] in bound else f"{tag[1]}{tag[2]}_", text)
    return re.sub(r"<\?xml\b[^<>]*>", "", text, count=1).lstrip()


def sha256(*values: Any) -> str:
    """Return the hexadecimal SHA-256 of the values in order: bytes as they are, other values as text."""
    return hashlib.sha256(b"\0".join(v if isinstance(v, bytes) else str(v).encode() for v in values)).hexdigest()
