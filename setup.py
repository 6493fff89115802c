"""Which Python packages there are and which data lie in them, for catkin (catkin_python_setup) and for pip.

A clone and a catkin workspace have them all at the top level. A wheel has applr_ros1 alone and the others below it,
where they collide with nobody's: `training.env` is `applr_ros1.training.env` there. In a clone that is its other name.
"""

import re
import sys
import xml.etree.ElementTree as xml
from pathlib import Path

from setuptools import find_namespace_packages, setup
from setuptools.command.build_py import build_py

BESIDE = ("sim_bridge", "training", "worlds")
OF_ROS = ("cfg", "launch", "rviz")  # CMakeLists.txt installs them
ABOVE = "applr_ros1." if {"bdist_wheel", "dist_info"} & set(sys.argv) else ""
NAME = "(%s)\\b" % "|".join(BESIDE)
RENAMED = {  # in the modules of a wheel: imports, "training.env.env:ApplrEnv", `python -m training.train`
    "(?m)^( *)from " + NAME: r"\1from applr_ros1.\2",
    "(?m)^( *)import " + NAME: r"\1from applr_ros1 import \2",
    '("|-m )' + NAME + r"(?=\.[a-z])": r"\1applr_ros1.\2",
}


class Build(build_py):
    """Copies modules, in which names are what they are in a wheel."""

    def build_module(self, module, module_file, package):
        """As of setuptools; a second time nothing is left to rename."""
        made, copied = super().build_module(module, module_file, package)
        text = Path(made).read_text(encoding="utf-8")
        for pattern, name in RENAMED.items() if ABOVE else ():
            text = re.sub(pattern, name, text)
        Path(made).write_text(text, encoding="utf-8")
        return made, copied


found = find_namespace_packages(  # folders of data are packages, too
    include=[pattern for name in ("applr_ros1", *BESIDE) for pattern in (name, name + ".*")],
    exclude=["applr_ros1." + name for name in OF_ROS],
)
setup(
    name="applr_ros1",
    version=xml.parse("package.xml").findtext("version"),
    license="MIT",
    packages=[(ABOVE if name.startswith(BESIDE) else "") + name for name in found],
    package_dir={ABOVE + name: name for name in BESIDE},
    package_data={"": ["*.yaml", "*.json", "*.md", "*.safetensors", "*.png", "*.npz", "*.html"]},
    cmdclass={"build_py": Build},
)
