"""A person's own method, a subclass of Method: `module:Class` or `my_file.py:Class`, `:text` for its constructor."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from types import ModuleType
from typing import Any, Optional

from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.policy.decision import Method


def make_user_method(module: str, name: str, text: Optional[str]) -> Method:
    """Make the class `name` of a module or of a .py file, with `text` if there is one.

    Raises:
        ApplrError: The class is no subclass of Method or cannot be made, for whatever reason.
    """
    try:
        kind = getattr(load_module(module), name)
        if isinstance(kind, type) and issubclass(kind, Method):
            return kind() if text is None else kind(text)
    except Exception as error:
        raise ApplrError("method %s:%s cannot be made: %s" % (module, name, one_line(error))) from error
    raise ApplrError(
        "method %s:%s is no subclass of applr_ros1.policy.methods.Method: derive it from that class" % (module, name)
    )


def load_module(module: str) -> ModuleType:
    """Import a module by its name, the current folder included, or by its file. Both may import what lies beside them.

    Raises:
        Exception: Whatever the module raises, and ImportError or OSError if it does not exist.
    """
    path = os.path.realpath(module) if module.endswith(".py") else ""
    folder = os.path.dirname(path) if path else os.getcwd()
    if folder not in sys.path:
        sys.path.append(folder)
    if not path:
        return importlib.import_module(module)
    name = path[: -len(".py")].replace(".", "_").replace(os.sep, "_")  # hides no other module
    if name not in sys.modules:
        found: Any = importlib.util.spec_from_file_location(name, path)
        sys.modules[name] = importlib.util.module_from_spec(found)
        try:
            found.loader.exec_module(sys.modules[name])
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
