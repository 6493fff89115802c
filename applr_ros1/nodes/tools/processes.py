"""Programs of other ROS packages in the place of this process."""

import os

from applr_ros1.common.errors import ApplrError


def become(package, program, arguments):
    """Replace this process by a program of another ROS package, as for rosrun, with a command line.

    Args:
        package: The ROS package, which is also the name of what has to be installed.
        program: Its program.
        arguments: Its command line.

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
    os.execv(found[0], [found[0], *arguments])
