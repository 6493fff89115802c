"""The stack of jackal_applr.launch on a ROS master of its own, for one process alone: the demo's and the playground's.

It is started by roslaunch. What the nodes print goes to a folder, their errors to this terminal.
"""

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

import rosgraph
import roslaunch.arg_dump
import roslaunch.rlutil
import rospy
from rosgraph.names import load_mappings

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.progress import announced
from applr_ros1.policy import methods
from applr_ros1.robots import NAMES

UP_WITHIN_S = 900.0  # of wall time for one part to come up: the first time it compiles kernels, maybe on a busy machine
COMPILES = "waiting for {} (its first start compiles kernels, about a minute)"
LAUNCH_FILE = "applr_ros1", "jackal_applr.launch"
DIED = re.compile(r"\[([\w/]+)-\d+\] (?:process )?has died")  # roslaunch's line about a node


def say(text):
    """Print one line of progress."""
    print(f"applr: {text}", flush=True)


def launch_arguments():
    """{name: default} of the launch file; None where it has none."""
    file = roslaunch.rlutil.resolve_launch_arguments(list(LAUNCH_FILE))[0]
    return {name: default for name, (_, default) in roslaunch.arg_dump.get_args([file]).items()}


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
    """A running Stack with these arguments {name: value}; it ends with the block. SIGTERM and SIGHUP act as Ctrl-C.

    The folder of what the nodes printed is kept where the block raises ApplrError, whose line says so.
    """
    folder, port = tempfile.mkdtemp(prefix="applr_"), free_port()
    os.environ.update(ROS_MASTER_URI=f"http://localhost:{port}", ROS_HOSTNAME="localhost", ROS_LOG_DIR=folder)
    for name in ("ROS_IP", "ROS_NAMESPACE"):  # of another robot
        os.environ.pop(name, None)
    say(f"for other ROS programs: ROS_MASTER_URI={os.environ['ROS_MASTER_URI']}")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    try:
        stack = Stack(given, port, folder)
        try:
            with announced("starting ROS", say, first=5.0):
                stack.wait(rosgraph.is_master_online, UP_WITHIN_S, "the ROS master does not come up")
            yield stack
        finally:
            stack.stop()
    except ApplrError as problem:
        raise ApplrError(f"{problem}; what the nodes printed is in {folder}") from None
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        raise KeyboardInterrupt("interrupted, every process has ended") from None
    shutil.rmtree(folder, ignore_errors=True)


class Stack:
    """The nodes of the launch file below this process, on a master of their own; roslaunch starts and ends them.

    Args:
        given: {name: value} of the launch file's arguments.
        port: Of the master.
        folder: For what the nodes print.
    """

    def __init__(self, given, port, folder):
        self._died, self._ends = "", False
        words = [f"{name}:={value}" for name, value in given.items()]
        options = [f"--port={port}", "--sigint-timeout=2", "--sigterm-timeout=0.5"]
        with open(os.path.join(folder, "roslaunch.log"), "w", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                ["roslaunch", *options, *LAUNCH_FILE, *words],
                stdout=log,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,  # a Ctrl-C ends it by `stop`
            )
        threading.Thread(target=self._pass_errors_on, daemon=True).start()

    def _pass_errors_on(self):
        for line in self._process.stderr:
            died = DIED.search(line)
            self._died = self._died or (died.group(1) + " has died" if died else "")
            if not self._ends:  # roslaunch's lines about nodes that take their time to end
                print(line, end="", file=sys.stderr)

    def check(self):
        """Raise ApplrError if a node has died."""
        if self._died or self._process.poll() is not None:
            raise ApplrError(self._died or "the stack ended by itself")

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
        self._ends = True
        rospy.signal_shutdown("the program that started the stack has ended")
        self._process.send_signal(signal.SIGINT)
        self._process.wait()
