"""The simulated robot: one interface (simulator.py), a pybullet and a kinematic implementation, and their laser.

Only ros_*.py know ROS.
"""
# Imports robots, worlds and common; no ROS but in ros_*.py.

from __future__ import annotations

from typing import Any, Union

from applr_ros1.robots import Robot, load

from .simulator import Randomisation, RobotState, Simulator, SimulatorError

__all__ = ["NAMES", "Randomisation", "RobotState", "Simulator", "SimulatorError", "make"]

NAMES = ("pybullet", "kinematic")


def make(name: str, robot: Union[Robot, str, None] = None, **randomisation: Any) -> Simulator:
    """Return a simulator by name.

    Args:
        name: One of NAMES.
        robot: Description of the robot, or its name or folder; the Jackal without one.
        **randomisation: Fields of Randomisation, such as latency=0.05 or slip=(0.5, 1.5).

    Raises:
        SimulatorError: An argument cannot be used; one line says which and what to give.
        ApplrError: There is no such robot, or its description cannot be used.
    """
    if name not in NAMES:
        raise SimulatorError(f"simulator {name!r} is not known: give {' or '.join(NAMES)}")
    described = load(robot) if isinstance(robot, str) else robot
    if name == "pybullet":  # imported here, so that the kinematic one needs no pybullet
        from .pybullet_simulator import PybulletSimulator

        return PybulletSimulator(described, **randomisation)
    from .kinematic_simulator import KinematicSimulator

    return KinematicSimulator(described, **randomisation)
