"""Reads the YAML files of a robot's folder: bounded in size, plain values only."""

from __future__ import annotations

from typing import Any, Dict

import yaml

from applr_ros1.common import files
from applr_ros1.common.errors import ApplrError

MAX_BYTES = 2**17


def read_yaml(path: str) -> Dict[str, Any]:
    """The mapping in a YAML file; {} for an empty file. ApplrError of one line for everything else."""
    text = files.read_bytes(path, MAX_BYTES)
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, LookupError, RecursionError) as error:  # ValueError: such as a date 2001-99-99
        raise ApplrError(f"{path}: not readable as YAML: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(found or {}, dict):
        raise ApplrError(f"{path}: holds no mapping; give lines such as name: value")
    return found or {}


def read_parameters(path: str) -> Dict[str, Any]:
    """The parameters of move_base in a YAML file, without the level move_base of one that is loaded beside the node.

    Raises:
        ApplrError: As `read_yaml` does.
    """
    found = read_yaml(path)
    inner = found.get("move_base")
    return inner if len(found) == 1 and isinstance(inner, dict) else found
