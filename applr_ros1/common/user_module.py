"""Imports a person's own code, which is named by a module or by a .py file."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from types import ModuleType


def load(module: str) -> ModuleType:
    """A module by its name, the current folder included, or by its file. Both may import what lies beside them.

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
        found = importlib.util.spec_from_file_location(name, path)
        assert found is not None
        assert found.loader is not None
        made = importlib.util.module_from_spec(found)
        sys.modules[name] = made
        try:
            found.loader.exec_module(made)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
