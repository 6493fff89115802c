"""Python packages and their data files, for catkin (catkin_python_setup) and for pip.

A clone and a catkin workspace have all packages at the top level. A wheel has them below applr_ros1, where they collide
with no other package: `training.env` is `applr_ros1.training.env` there. A clone knows both names.
"""

import re
import sys
import xml.etree.ElementTree as xml
from pathlib import Path
from typing import Any

from setuptools import find_namespace_packages, setup
from setuptools.command.build_py import build_py

BESIDE = ("sim_bridge", "training", "worlds")
OF_ROS = ("cfg", "launch", "rviz")  # folders that CMakeLists.txt installs
ABOVE = "applr_ros1." if {"bdist_wheel", "dist_info"} & set(sys.argv) else ""
NAME = "(%s)\\b" % "|".join(BESIDE)
RENAMED = {  # {pattern: replacement} in a wheel: imports, "training.env.env:ApplrEnv", `python -m training.train`
    "(?m)^( *)from " + NAME: r"\1from applr_ros1.\2",
    "(?m)^( *)import " + NAME: r"\1from applr_ros1 import \2",
    '("|-m )' + NAME + r"(?=\.[a-z])": r"\1applr_ros1.\2",
}


class Build(build_py):  # type: ignore[misc]  # setuptools has no type hints.
    """Command that copies modules, and renames the packages in them for a wheel."""

    def build_module(self, module: str, module_file: str, package: Any) -> Any:
        """Copy a module like setuptools, and rename its imports. A second call finds nothing to rename."""
        made, copied = super().build_module(module, module_file, package)
        text = Path(made).read_text(encoding="utf-8")
        for pattern, name in RENAMED.items() if ABOVE else ():
            text = re.sub(pattern, name, text)
        Path(made).write_text(text, encoding="utf-8")
        return made, copied


packages = find_namespace_packages(  # Folders of data are packages, too.
    include=[pattern for name in ("applr_ros1", *BESIDE) for pattern in (name, name + ".*")],
    exclude=["applr_ros1." + name for name in OF_ROS],
)
setup(
    name="applr_ros1",
    version=xml.parse("package.xml").findtext("version"),
    license="MIT",
    packages=[(ABOVE if name.startswith(BESIDE) else "") + name for name in packages],
    package_dir={ABOVE + name: name for name in BESIDE},
    package_data={"": ["*.yaml", "*.json", "*.md", "*.safetensors", "*.png", "*.npz", "*.html"]},
    cmdclass={"build_py": Build},
)
