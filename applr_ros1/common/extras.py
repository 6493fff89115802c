"""Messages about missing Python packages, including optional ones (extras of `pip install`)."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Iterator, Optional

OURS = ("applr_ros1", "sim_bridge", "training", "worlds")
TRAINING = ("torch", "tensorboard", "cma", "ruptures", "rosbags", "lz4", "minari", "h5py")
# package: extra of `pip install` that installs it, as in pyproject.toml
EXTRAS = {
    "matplotlib": "draw",
    **dict.fromkeys(TRAINING, "train"),
    **dict.fromkeys(("yourdfpy", "xacrodoc"), "urdf"),
    "pybullet": "pybullet",
    "ray": "cluster",
}


def absent(package: Optional[str]) -> str:
    """Return a message if a package is not installed, otherwise "".

    Packages of this repository count as installed.
    """
    package_name = (package or "").partition(".")[0]
    if not package_name or package_name in OURS or find_spec(package_name):
        return ""
    command = "run ./applr packages in the clone of applr_ros1, then build this workspace again"
    if package_name in EXTRAS:
        command = f"in the clone of applr_ros1, pip install '.[{EXTRAS[package_name]}]'"
    return f"Python's {package_name} is not installed for {sys.executable}: {command}"


@contextmanager
def extra(importer: str) -> Iterator[None]:
    """Guard the imports of a command that needs an extra.

    Args:
        importer: The module's __name__. If it is "__main__", a missing package ends the command
            with one line and exit status 1, otherwise the ModuleNotFoundError is raised.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        message = absent(missing.name)
        if importer != "__main__" or not message:
            raise
        sys.exit(message)
