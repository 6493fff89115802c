"""Python packages and their data files, for catkin (catkin_python_setup) and for pip.

pip installs the packages under the names that they have in a clone. Install them into an
environment of their own: `training` and `worlds` are names that other projects use, too.
"""

import xml.etree.ElementTree as xml

from setuptools import find_namespace_packages, setup

PACKAGES = ("applr_ros1", "sim_bridge", "training", "worlds")
OF_ROS = ("cfg", "launch", "rviz")  # folders that CMakeLists.txt installs
DATA = [
    "*.yaml",
    "*.json",
    "*.md",
    "*.safetensors",
    "*.png",
    "*.npz",
    "*.world",
    "*.html",
    "*.css",
    "*.js",
]

setup(
    name="applr_ros1",
    version=xml.parse("package.xml").findtext("version"),
    license="MIT",
    packages=find_namespace_packages(  # Folders of data are packages, too.
        include=[pattern for name in PACKAGES for pattern in (name, name + ".*")],
        exclude=["applr_ros1." + name for name in OF_ROS],
    ),
    package_data={"": DATA},
)
