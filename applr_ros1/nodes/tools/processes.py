"""Programs of other ROS packages that take the place of this process or end with it."""

import ctypes
import os
import signal

from applr_ros1.common.errors import ApplrError

_SET_PARENT_DEATH_SIGNAL = 1  # linux/prctl.h


def program_of(package, program):
    """The path of a program of another ROS package, as for rosrun.

    Args:
        package: The ROS package, which is also the name of what has to be installed.
        program: Its program.

    Raises:
        ApplrError: There is no such program.
    """
    import roslib.packages
    import rospkg

    try:
        found = roslib.packages.find_node(package, program)
    except rospkg.ResourceNotFound:
        found = []
    if not found:
        raise ApplrError(
            f"{package} is not installed: apt-get install {package} (ros-noetic-{package} on Ubuntu 20.04)"
        )
    return found[0]


def become(package, program, arguments):
    """Replace this process by a program of another ROS package with a command line. Raises as `program_of`."""
    path = program_of(package, program)
    os.execv(path, [path, *arguments])


def leave_with_parent():
    """For Popen's preexec_fn: the child gets SIGINT if its parent dies."""
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGINT, 0, 0, 0)
