"""Imports a person's own code, which is named by a module or by a .py file."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from types import ModuleType
from typing import Any


def load(module: str) -> ModuleType:
    """Return a module by its name, the current folder included, or by its file. Both may import what lies beside them.

    Raises:
        Exception: whatever the module raises, and ImportError or OSError where it is not there.
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
