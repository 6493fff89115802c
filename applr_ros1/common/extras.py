"""Packages that only some commands need: an extra of `pip install` brings each (pyproject.toml)."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Iterator, Optional

EXTRAS = {
    "matplotlib": "report",
    **dict.fromkeys(("torch", "tensorboard", "cma", "ruptures", "rosbags", "lz4", "minari", "h5py"), "train"),
    **dict.fromkeys(("yourdfpy", "xacrodoc"), "urdf"),
    "pybullet": "pybullet",
    "ray": "cluster",
}


def absent(package: Optional[str]) -> str:
    """Return the line about a package of an extra that is not installed; "" where it is, or is of no extra."""
    name = (package or "").partition(".")[0]
    if name not in EXTRAS or find_spec(name):
        return ""
    return f"Python's {name} is not installed: in the clone of applr_ros1, pip install '.[{EXTRAS[name]}]'"


@contextmanager
def extra(importer: str) -> Iterator[None]:
    """Guard the imports of a command for which an extra is needed.

    Args:
        importer: the module's __name__. As a command, which is "__main__", it ends with one line where a package is
            missing, and exit status 1; imported, it raises the ModuleNotFoundError.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        line = absent(missing.name)
        if importer != "__main__" or not line:
            raise
        sys.exit(line)
