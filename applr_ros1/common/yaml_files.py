"""YAML of strangers: plain values, and a bound on how many."""

from __future__ import annotations

import math
from typing import Any, Dict, Tuple

import yaml

from applr_ros1.common.files import StorageError, read_bytes, whole_number

MAX_YAML = 2**20
MAX_VALUES, MAX_LEVELS = 100_000, 50  # of a YAML file, each alias counted as what it stands for


class Yaml(yaml.SafeLoader):
    """A loader of plain values alone, and no more of them than a person writes: aliases can stand for any number."""

    most = MAX_VALUES

    def get_single_node(self) -> Any:
        """Return the node of which yaml.load makes the value."""
        node = super().get_single_node()
        values, levels = _extent(node, {})
        if values > self.most or levels > MAX_LEVELS:
            raise yaml.YAMLError(f"more than {self.most} values or {MAX_LEVELS} levels")
        return node


def _int(loader: Any, node: Any) -> int:
    return whole_number(loader.construct_yaml_int(node))


Yaml.add_constructor("tag:yaml.org,2002:int", _int)


def _extent(node: Any, known: Dict[int, Tuple[float, float]]) -> Tuple[float, float]:
    """Return (values, levels) of a node of YAML; infinite where it holds itself. known: those of others, by id."""
    if id(node) not in known:
        known[id(node)] = math.inf, math.inf
        parts = node.value if isinstance(node, (yaml.SequenceNode, yaml.MappingNode)) else []
        below = [_extent(one, known) for part in parts for one in (part if isinstance(part, tuple) else [part])]
        known[id(node)] = 1 + sum(values for values, _ in below), 1 + max((levels for _, levels in below), default=0)
    return known[id(node)]


def read_yaml(path, limit: int = MAX_YAML, loader: Any = Yaml) -> Any:
    """Return the value in a YAML file."""
    return yaml_value(read_bytes(path, limit), path, loader)


def yaml_value(text, name, loader: Any = Yaml) -> Any:
    """Return the value that a YAML text holds; StorageError, one line that begins with `name`, where it is none."""
    try:
        return yaml.load(text, loader)
    except Exception as error:  # of constructors that expect no stranger's file
        raise StorageError(f"{name}: not readable as YAML: {' '.join(str(error).split())[:200]}") from None
