"""Reader of YAML with plain values. A tag that would create a Python object is an error."""

from __future__ import annotations

from typing import Any

import yaml

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes


def read_yaml(path: Any) -> Any:
    """Return the value in a YAML file."""
    return yaml_value(read_bytes(path), path)


def yaml_value(text: Any, name: Any, loader: Any = yaml.SafeLoader) -> Any:
    """Return the value of a YAML text. Raises ApplrError if it is invalid; the line begins with `name`."""
    try:
        return yaml.load(text, loader)
    except (yaml.YAMLError, ValueError) as error:  # An impossible date or angle is a ValueError.
        raise ApplrError(f"{name}: not readable as YAML: {' '.join(str(error).split())[:200]}") from None
