"""Which Python packages there are and which data lie in them, for catkin (catkin_python_setup) and for pip."""

import xml.etree.ElementTree as xml

from setuptools import find_packages, setup

PACKAGES = ("applr_ros1", "sim_bridge", "training", "worlds")

setup(
    name="applr_ros1",
    version=xml.parse("package.xml").findtext("version"),
    packages=find_packages(include=[pattern for name in PACKAGES for pattern in (name, name + ".*")]),
    package_data={
        "applr_ros1": ["models/*", "robots/*/*", "robots/*/*/*", "robots/*/*/*/*"],
        "training": ["recipes/*.yaml", "report/*.html"],
        "worlds": ["data/*"],
    },
)
