"""Child processes that always end: started apart from the terminal's Ctrl-C and ended by their pids, never by name.

The demo runs the whole stack as one such child (roslaunch with everything below it).
"""

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import time

from applr_ros1.common.errors import ApplrError

_SET_PARENT_DEATH_SIGNAL, _SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h


class ProgramError(ApplrError):
    """A program of another ROS package that is not installed; one line."""


def become(package, program, arguments):
    """Replace this process by a program of another ROS package.

    Args:
        package: The ROS package, which is also the name of what has to be installed.
        program: Its program, as for rosrun.
        arguments: The command line.

    Raises:
        ProgramError: There is no such program.
    """
    import roslib.packages
    import rospkg

    try:
        found = roslib.packages.find_node(package, program)
    except rospkg.ResourceNotFound:
        found = []
    if not found:
        raise ProgramError(
            "%s is not installed: apt-get install %s (ros-noetic-%s on Ubuntu 20.04)" % (package, package, package)
        )
    os.execv(found[0], [found[0], *arguments])


def free_port():
    """A TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def port_is_free(port):
    """Whether a server could listen on this TCP port of localhost now."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("localhost", port))
        except OSError:
            return False
        return True


def adopt_orphans():
    """Processes below this one whose parent ends become children of this one, so that they can still be found."""
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _leave_with_parent():
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
        preexec_fn=_leave_with_parent,
    )


def descendants(root=None):
    """Pids of all living processes below `root` (this process by default)."""
    children = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open("/proc/%s/stat" % entry) as stat:
                    state, parent = stat.read().rpartition(")")[2].split()[:2]
            except (OSError, ValueError):
                continue  # it ended meanwhile
            if state != "Z":
                children.setdefault(int(parent), []).append(int(entry))
    found, todo = [], [root or os.getpid()]
    while todo:
        below = children.get(todo.pop(), [])
        found += below
        todo += below
    return found


def memory(pids):
    """Resident memory of these processes together [bytes], what they share counted for each."""
    total = 0
    for pid in pids:
        try:
            with open("/proc/%d/statm" % pid) as statm:
                total += int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, ValueError, IndexError):
            continue
    return total


def stop(process, patience=3.0):
    """End `process` and everything below this process: SIGINT first, SIGKILL for what is left after `patience` [s]."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline and (process.poll() is None or descendants()):
        time.sleep(0.05)
    for _ in range(20):  # what is killed may leave children that only then become ours
        left = descendants()
        if not left:
            break
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)
    process.poll()
