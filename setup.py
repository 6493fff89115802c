"""Which Python packages there are and which data lie in them, for catkin (catkin_python_setup) and for pip."""

import xml.etree.ElementTree as xml

from setuptools import find_namespace_packages, setup

PACKAGES = ("applr_ros1", "sim_bridge", "training", "worlds")
OF_ROS = ("cfg", "launch", "rviz", "scripts")  # CMakeLists.txt installs them

setup(
    name="applr_ros1",
    version=xml.parse("package.xml").findtext("version"),
    license="MIT",
    packages=find_namespace_packages(  # folders of data are packages, too
        include=[pattern for name in PACKAGES for pattern in (name, name + ".*")],
        exclude=["applr_ros1." + name for name in OF_ROS],
    ),
    package_data={"": ["*.yaml", "*.json", "*.md", "*.safetensors", "*.png", "*.npz", "*.html"]},
)
