"""The simulated robot: one interface (simulator.py), a pybullet and a kinematic implementation, and their laser.

Only ros_*.py and the folder gazebo know ROS. A simulator of your own derives from Simulator, passes
`python -m sim_bridge.check my_file.py:Class`, and is then given by that name wherever a simulator is named.
"""

from __future__ import annotations

from typing import Any, Type, Union

from applr_ros1.common import user_module
from applr_ros1.common.errors import ApplrError, one_line
from applr_ros1.robots import Robot, load

from .simulator import Randomisation, RobotState, Simulator, SimulatorError

__all__ = ["NAMES", "Randomisation", "RobotState", "Simulator", "SimulatorError", "find", "is_name", "make"]

# name -> where the class is. They are imported on first use, so that the kinematic one needs no pybullet.
_CLASSES = {
    "pybullet": "sim_bridge.pybullet_simulator:PybulletSimulator",
    "kinematic": "sim_bridge.kinematic_simulator:KinematicSimulator",
}
NAMES = tuple(_CLASSES)


def is_name(text: str) -> bool:
    """Whether a simulator can be named so: one of NAMES, or the my_file.py:Class or module:Class of your own.

    It is not imported.
    """
    return text in NAMES or ":" in text


def find(name: str) -> Type[Simulator]:
    """The class of a simulator.

    Args:
        name: One of NAMES, or my_file.py:Class or module:Class for a Simulator of your own.

    Raises:
        SimulatorError: There is none, or it cannot be imported; one line says what to give.
    """
    module, colon, kind = _CLASSES.get(name, str(name)).rpartition(":")
    if not (module and colon and kind):
        raise SimulatorError(
            f"simulator {name!r} is not known: give {' or '.join(NAMES)}, or my_file.py:Class or module:Class"
        )
    # whatever a person's own class raises is theirs to hear in one line
    expected: Type[Exception] = ImportError if name in _CLASSES else Exception
    try:
        found = getattr(user_module.load(module), kind)
    except expected as error:
        raise SimulatorError(
            f"simulator {name} cannot be imported ({one_line(error)}): check module and class"
        ) from error
    if not (isinstance(found, type) and issubclass(found, Simulator)):
        raise SimulatorError(f"simulator {name} is no sim_bridge.Simulator: derive it from that class")
    return found


def make(name: str, gui: bool = False, robot: Union[Robot, str, None] = None, **randomisation: Any) -> Simulator:
    """A simulator by name.

    Args:
        name: As for find().
        gui: Whether to open the simulator's window; only pybullet has one.
        robot: Description of the robot, or its name or folder; the Jackal without one.
        **randomisation: Fields of Randomisation, such as latency=0.05 or slip=(0.5, 1.5).

    Raises:
        SimulatorError: An argument cannot be used; one line says which and what to give.
        ApplrError: There is no such robot, or its description cannot be used.
    """
    if gui and name != "pybullet":
        raise SimulatorError(f"gui is true but the simulator {name} has no window: take pybullet")
    found = find(name)
    options = dict(randomisation)
    if gui:
        options["gui"] = True
    if robot is not None:
        options["robot"] = load(robot) if isinstance(robot, str) else robot
    try:
        made: Simulator = found(**options)
    except ApplrError:
        raise
    except Exception as error:
        if name in _CLASSES:
            raise
        raise SimulatorError(f"simulator {name} cannot be made: {one_line(error)}") from error
    return made
