"""Tells catkin (catkin_python_setup) which Python packages there are and which data lie in them. Not for pip."""
from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(**generate_distutils_setup(
    packages=[
        "applr_ros1", "applr_ros1.planner", "applr_ros1.policy", "applr_ros1.nodes",
        "sim_bridge", "training", "training.report", "worlds",
    ],
    package_data={"applr_ros1": ["models/*"], "worlds": ["data/*"], "training": ["*.json", "*.html"]},
))
