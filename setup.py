"""Tells catkin (catkin_python_setup) which Python packages there are and which data lie in them. Not for pip."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

PACKAGES = ("applr_ros1", "sim_bridge", "training", "worlds")

setup(
    **generate_distutils_setup(
        packages=find_packages(include=[pattern for name in PACKAGES for pattern in (name, name + ".*")]),
        package_data={
            "applr_ros1": ["models/*", "robots/*/*", "robots/*/*/*", "robots/*/*/*/*"],
            "training": ["recipes/*.yaml", "report/*.html"],
            "worlds": ["data/*"],
        },
    )
)
