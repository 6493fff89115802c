"""The robot's stand-in worlds: one interface (simulator.py), a physical and a kinematic Jackal, and their
laser. No ROS in here but in ros_bridge.py.
"""

from .simulator import Randomisation, RobotState, Simulator, SimulatorError

__all__ = ["Randomisation", "RobotState", "Simulator", "SimulatorError", "make"]


def make(name: str, **randomisation) -> Simulator:
    """A simulator by name, "pybullet" or "kinematic". `randomisation`: see Randomisation. Imported on first
    use, so the kinematic one needs no pybullet.
    """
    if name == "kinematic":
        if randomisation.pop("gui", False):
            raise SimulatorError("gui is true but the kinematic simulator has no window: take pybullet")
        from .kinematic_simulator import KinematicSimulator

        return KinematicSimulator(**randomisation)
    if name == "pybullet":
        from .pybullet_simulator import PybulletSimulator

        return PybulletSimulator(**randomisation)
    raise SimulatorError("simulator %r is not known: take pybullet or kinematic" % (name,))
