"""Reads the YAML files of a robot's folder: bounded in size, plain values only, every key once.

reader.py and parameter_files.py call it. Anchors are refused because a few lines of them can stand for gigabytes.
"""

from __future__ import annotations

import os
from typing import Any, Dict

import yaml

from applr_ros1.common import files
from applr_ros1.robots.kinds import RobotError

MAX_BYTES = 2**17


class _Loader(yaml.SafeLoader):
    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not taken", problem_mark=self.peek_event().start_mark
            )
        return super().compose_node(parent, index)

    def construct_object(self, node, deep=False):
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
            kind = node.tag.rpartition(":")[2]
            given = "%.40r" % node.value if isinstance(node, yaml.ScalarNode) else "this"
            problem = "%s is no %s" % (given, kind)
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from None

    def construct_mapping(self, node, deep=False):
        known = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if not isinstance(key, yaml.ScalarNode):
                problem = "a name is a list or a mapping; give a word"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            if key.value in known:
                raise yaml.MarkedYAMLError(problem="%s is given twice" % key.value, problem_mark=key.start_mark)
            known.add(key.value)
        return super().construct_mapping(node, deep)


def read(path: str) -> Dict[str, Any]:
    """The mapping in a YAML file; {} for an empty file. RobotError of one line for everything else."""
    data = files.read_bytes(path, MAX_BYTES, RobotError)
    try:
        found = yaml.load(data.decode(), _Loader)
    except yaml.MarkedYAMLError as error:
        line = " in line %d" % (error.problem_mark.line + 1) if error.problem_mark else ""
        raise RobotError("%s: not readable as YAML%s: %s" % (path, line, error.problem or "syntax error")) from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = (str(error).splitlines() or ["syntax error"])[0]
        raise RobotError("%s: not readable as YAML: %s" % (path, reason)) from None
    if found is None:
        return {}
    if not isinstance(found, dict):
        raise RobotError("%s: holds no mapping; give lines such as name: value" % os.path.basename(path))
    return found
