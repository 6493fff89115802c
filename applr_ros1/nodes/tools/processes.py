"""Child processes that always end: started apart from the terminal's Ctrl-C and ended by their pids, never by name."""

import contextlib
import ctypes
import os
import signal
import socket
import subprocess

import psutil

from applr_ros1.common.errors import ApplrError

_SET_PARENT_DEATH_SIGNAL, _SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h


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


def free_port():
    """A TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def adopt_orphans():
    """Processes below this one whose parent ends become children of this one, so that they can still be found."""
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def leave_with_parent():
    """For Popen's preexec_fn: the child gets SIGINT if its parent dies."""
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGINT, 0, 0, 0)


def start(command, environment, output):
    """Popen of `command` in a session of its own; it gets SIGINT if this process dies."""
    return subprocess.Popen(
        command,
        env=environment,
        stdout=output,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=leave_with_parent,
    )


def stop(process, patience=3.0):
    """End `process` and everything below this process: SIGINT first, SIGKILL for what is left after `patience` [s]."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    psutil.wait_procs(psutil.Process().children(recursive=True), patience)
    for _ in range(20):  # what is killed may leave children that only then become ours
        left = psutil.Process().children(recursive=True)
        for child in left:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
        psutil.wait_procs(left, 1.0)
