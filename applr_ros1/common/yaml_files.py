"""YAML of plain values: a tag that would make a Python object is an error."""

from __future__ import annotations

from typing import Any

import yaml

from applr_ros1.common.files import StorageError, read_bytes


def read_yaml(path) -> Any:
    """Return the value in a YAML file."""
    return yaml_value(read_bytes(path), path)


def yaml_value(text, name, loader: Any = yaml.SafeLoader) -> Any:
    """Return the value that a YAML text holds; StorageError, one line that begins with `name`, where it is none."""
    try:
        return yaml.load(text, loader)
    except (yaml.YAMLError, ValueError) as error:  # the latter: a date or an angle that cannot be
        raise StorageError(f"{name}: not readable as YAML: {' '.join(str(error).split())[:200]}") from None
