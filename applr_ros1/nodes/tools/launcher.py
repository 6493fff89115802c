"""The stack of jackal_applr.launch on a ROS master of its own, for one process alone: the demo's and the playground's.

It is started through roslaunch's parent API. What the nodes print goes to a folder, their errors to this terminal.
"""

import contextlib
import os
import shutil
import signal
import socket
import sys
import tempfile
import time
import uuid

import roslaunch
import roslaunch.arg_dump
import rospy
from rosgraph.names import load_mappings

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.policy import methods
from applr_ros1.robots import NAMES

UP_WITHIN_S = 900.0  # of wall time for one part to come up: the first time it compiles kernels, maybe on a busy machine
COMPILES = "waiting for {} (its first start compiles kernels, about a minute)"
roslaunch.launch._TIMEOUT_MASTER_START = 120.0  # s of wall time; its own 10 are too few on a busy machine


def say(text):
    """Print one line of progress."""
    print(f"applr: {text}", flush=True, file=sys.__stdout__)


def launch_arguments():
    """{name: default} of the launch file; None where it has none."""
    return {name: default for name, (_, default) in roslaunch.arg_dump.get_args([_launch_file()]).items()}


def given_arguments(words, known):
    """{name: value} of ARG:=VALUE; ROS's own arguments, such as __name:=N, are left out. Raises ApplrError.

    Paths get their folder, because the nodes run in another one.
    """
    for word in words:
        name, separator, value = word.partition(":=")
        if not separator or name not in known and not name.startswith("_"):
            raise ApplrError(f"{word} is no argument: give ARG:=VALUE; there are {', '.join(known)}")
        if not value:  # which load_mappings leaves out: another robot drove than was meant
            raise ApplrError(f"{name} is empty: give a value, or leave it out")
    given = load_mappings(words)
    if "method" in given:
        given["method"] = methods.absolute(given["method"])
    for name in {"robot", "world", "record"} & set(given):
        if given[name] not in (*NAMES, "none") and (name == "record" or os.path.exists(given[name])):
            given[name] = os.path.abspath(given[name])
    return given


def free_port():
    """A TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def private_stack(given):
    """A running Stack with these arguments {name: value}; it ends with the block.

    The folder of what the nodes printed is kept where the block raises ApplrError, whose line says so.
    """
    folder, port = tempfile.mkdtemp(prefix="applr_"), free_port()
    os.environ.update(ROS_MASTER_URI=f"http://localhost:{port}", ROS_HOSTNAME="localhost", ROS_LOG_DIR=folder)
    for name in ("ROS_IP", "ROS_NAMESPACE"):  # of another robot
        os.environ.pop(name, None)
    say(f"for other ROS programs: ROS_MASTER_URI={os.environ['ROS_MASTER_URI']}")
    stack = Stack(given, port)
    try:
        with open(os.path.join(folder, "roslaunch.log"), "w", encoding="utf-8") as log, contextlib.redirect_stdout(log):
            try:
                with announced("starting ROS", say, first=5.0):
                    stack.start()
                yield stack
            finally:
                with contextlib.redirect_stderr(log):  # roslaunch's lines about nodes that take their time to end
                    stack.stop()
    except ApplrError as problem:
        raise ApplrError(f"{problem}; what the nodes printed is in {folder}") from None
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)


class Stack(roslaunch.pmon.ProcessListener):
    """The nodes of the launch file below this process, on a master of their own.

    Make and start it in the main thread. SIGINT, SIGTERM or SIGHUP make check() raise; while it starts, roslaunch's own
    handlers end the nodes as well.
    """

    def __init__(self, given, port):
        self._ended, self._interrupted = "", False
        self._take_signals()
        self._parent = roslaunch.parent.ROSLaunchParent(
            str(uuid.uuid1()),
            [(_launch_file(), [f"{name}:={value}" for name, value in given.items()])],
            port=port,
            process_listeners=[self],
            force_log=True,
            show_summary=False,
            sigint_timeout=2.0,
            sigterm_timeout=0.5,
        )

    def _take_signals(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._interrupt)

    def _interrupt(self, *_):
        self._interrupted = True

    def process_died(self, process_name, exit_code):
        """Called by roslaunch for a process that ended, also for one that it starts again."""
        if exit_code:
            self._ended = self._ended or f"{process_name.rpartition('-')[0]} ended with status {exit_code}"

    def start(self):
        """Start master and nodes. Raises ApplrError for a launch file that cannot be loaded."""
        try:
            self._parent.start(auto_terminate=False)
        except roslaunch.RLException as error:
            raise ApplrError(" ".join(str(error).split())) from None
        self._take_signals()

    def check(self):
        """Raises KeyboardInterrupt after a Ctrl-C, ApplrError when a node has ended by itself."""
        if self._interrupted:
            raise KeyboardInterrupt("interrupted, every process has ended")
        if self._ended or self._parent.pm.is_shutdown:
            raise ApplrError(self._ended or "the stack ended by itself")

    def wait(self, condition, seconds, otherwise, pause=0.02):
        """Wait in wall time until condition() is true; raises as check() does, and ApplrError(otherwise)."""
        deadline = time.monotonic() + seconds
        while not condition():
            self.check()
            if time.monotonic() > deadline:
                raise ApplrError(f"{otherwise} within {seconds:g} s")
            time.sleep(pause)

    def wait_until_up(self, part, condition, seconds=UP_WITHIN_S, pause=0.02):
        """The same for a part of the stack to come up, and say what it may be doing."""
        with announced(COMPILES.format(part), say, first=10.0):
            self.wait(condition, seconds, f"{part} does not come up", pause)

    def stop(self):
        """End all processes."""
        rospy.signal_shutdown("the program that started the stack has ended")
        self._parent.shutdown()


def _launch_file():
    return roslaunch.rlutil.resolve_launch_arguments(["applr_ros1", "jackal_applr.launch"])[0]
