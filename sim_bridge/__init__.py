"""Simulated robot: one interface (simulator.py), two implementations, and their laser.

Only the modules ros_*.py depend on ROS.
"""

from __future__ import annotations

from typing import Any, Union

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import Robot, load

from .simulator import Randomisation, RobotState, Simulator

__all__ = ["NAMES", "Randomisation", "RobotState", "Simulator", "check_name", "make"]

NAMES = ("pybullet", "kinematic")


def check_name(name: str) -> None:
    """Raise ApplrError if there is no simulator of this name."""
    if name not in NAMES:
        raise ApplrError(f"simulator {name!r} is unknown: give {' or '.join(NAMES)}")


def make(name: str, robot: Union[Robot, str, None] = None, **randomisation: Any) -> Simulator:
    """Return a simulator by name.

    Args:
        name: One of NAMES.
        robot: Description, name or folder of the robot; the Jackal by default.
        **randomisation: Fields of Randomisation, such as latency=0.05 or slip=(0.5, 1.5).

    Raises:
        ApplrError: There is no such simulator or robot, or an argument is invalid.
    """
    check_name(name)
    described = load(robot) if isinstance(robot, str) else robot
    if name == "pybullet":  # Imported only here: the kinematic simulator works without pybullet.
        from .pybullet_simulator import PybulletSimulator

        return PybulletSimulator(described, **randomisation)
    from .kinematic_simulator import KinematicSimulator

    return KinematicSimulator(described, **randomisation)
