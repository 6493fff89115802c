"""Launcher of jackal_applr.launch on a private ROS master, for the demo and the playground.

roslaunch starts the stack. The output of the nodes goes to a folder, and their errors to the
terminal.
"""

from __future__ import annotations

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
from typing import Any, Callable, Collection, Dict, Iterator, List, Mapping, Sequence, Tuple, Union

import rosgraph
import roslaunch.arg_dump
import roslaunch.rlutil
import rospy
from rosgraph.names import load_mappings

import sim_bridge
from applr_ros1.common.arguments import boolean, check_names, number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import is_in_writable_folder
from applr_ros1.common.progress import announced
from applr_ros1.policy import methods
from applr_ros1.robots import NAMES, Robot, load
from applr_ros1.robots.robot_world import world_of
from worlds import World

# Longest wall time for a part to start, with the compilation of kernels on a busy machine [s]
UP_WITHIN_S = 900.0
# Longest wall time in which roslaunch, after SIGINT, ends the nodes, of which each takes 2.5 s [s]
ENDED_WITHIN_S = 60.0
COMPILES = "waiting for {} (the first start compiles code, which takes about a minute)"
LAUNCH_FILE = ("applr_ros1", "jackal_applr.launch")
# roslaunch's line about a node that has died
DIED = re.compile(r"\[([\w/]+)-\d+\] (?:process )?has died")
NO_MASTER = "could not contact master"  # roslaunch's line about a master that it has started


def report(text: str) -> None:
    """Print one progress line."""
    print(f"applr: {text}", flush=True)


def launch_arguments() -> Dict[str, Any]:
    """Return the launch file's arguments as {name: default}.

    The default is None if there is none.
    """
    launch_file, *_ = roslaunch.rlutil.resolve_launch_arguments(list(LAUNCH_FILE))
    declarations = roslaunch.arg_dump.get_args([launch_file])  # {name: (doc, default)}
    return {name: default for name, (_, default) in declarations.items()}


def given_arguments(
    words: Sequence[str], of_launch_file: Mapping[str, Any], others: Collection[str] = ()
) -> Dict[str, str]:
    """Parse ARG:=VALUE into {name: value}, without ROS's own arguments such as __name:=N.

    Paths become absolute, because the nodes run in another folder.

    Args:
        words: The words of a command line.
        of_launch_file: Arguments of the launch file, as {name: default}.
        others: Names of further arguments, which the program checks itself.

    Raises:
        ApplrError: An argument is unknown, has no value, or one of another kind than its default.
    """
    check_names(words, (*of_launch_file, *others))
    for word in words:
        argument_name, _, value = word.partition(":=")
        if not value:  # load_mappings would silently drop it, and the default would be used.
            raise ApplrError(f"{argument_name} is empty: give a value or omit it")
    # ROS's own parser, so that words mean the same as on roslaunch's command line.
    arguments: Dict[str, str] = load_mappings(words)
    for argument_name in set(of_launch_file) & set(arguments):
        _check_kind(argument_name, arguments[argument_name], str(of_launch_file[argument_name]))
    if "method" in arguments:
        arguments["method"] = methods.absolute(arguments["method"])
    for argument_name in {"robot", "world", "record"} & set(arguments):
        if _is_path(argument_name, arguments[argument_name]):
            arguments[argument_name] = os.path.abspath(arguments[argument_name])
    if arguments.get("record", "none") != "none":
        check_file("record", arguments["record"], ".bag")
    return arguments


def check_file(name: str, path: str, ending: str) -> None:
    """Raise ApplrError if a file of a name with this ending cannot be written.

    A drive of minutes must not end with a file that cannot be written.
    """
    if not is_in_writable_folder(path) or not path.endswith(ending):
        advice = f"give a {ending} file in a folder that can be written"
        raise ApplrError(f"{name} is {path}: {advice}")


def _check_kind(name: str, value: str, default: str) -> None:
    """Raise ApplrError if a default is a switch or a number, and a value is not.

    roslaunch would report it with a part of the launch file, or a node when it starts.
    """
    if default in ("true", "false"):
        boolean(name, value)
    elif isinstance(read(default), float):
        number_within(name, read(value), 0.0)


def read(text: str) -> Union[float, str]:
    """Return a text as a number if it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def scene_of(arguments: Mapping[str, Any]) -> Tuple[Robot, World]:
    """Return the robot and the world that arguments {name: value} choose for a simulated drive.

    Raises:
        ApplrError: There is no such robot, world or simulator, or the robot cannot drive on a map.
    """
    robot = load(arguments["robot"])
    if boolean("map", arguments["map"]):
        robot.on_map()
    sim_bridge.check_name(arguments["simulator"])
    return robot, world_of(arguments["world"], robot)


def _is_path(name: str, value: str) -> bool:
    """Return whether an argument is a path, not a name such as jackal or generated:0."""
    if value in (*NAMES, "none"):
        return False
    # A bag need not exist yet, and a map may be given with a number, as in office.yaml:7.
    return name == "record" or ".yaml" in value or os.path.exists(value)


def free_port() -> int:
    """Return a free TCP port."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def private_nodes(arguments: Dict[str, str]) -> Iterator[LaunchedNodes]:
    """Run the nodes with the arguments {name: value} for the duration of a block.

    SIGTERM and SIGHUP act like Ctrl-C. If the block raises ApplrError, the folder with the nodes'
    output is kept and named in the error.
    """
    folder = tempfile.mkdtemp(prefix="applr_")
    port = free_port()
    master_address = f"http://localhost:{port}"
    os.environ.update(ROS_MASTER_URI=master_address, ROS_HOSTNAME="localhost", ROS_LOG_DIR=folder)
    # These variables may be set for another robot.
    for variable_name in ("ROS_IP", "ROS_NAMESPACE"):
        os.environ.pop(variable_name, None)
    report(f"for other ROS programs: ROS_MASTER_URI={master_address}")
    # Without this, a closed terminal would leave all nodes running.
    for signal_number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(signal_number, signal.default_int_handler)
    try:
        nodes = LaunchedNodes(arguments, port, folder)
        try:
            nodes.wait("the ROS master", rosgraph.is_master_online)
            nodes.show_errors()
            yield nodes
        finally:
            nodes.stop()
    except ApplrError as problem:
        raise ApplrError(f"{problem}; the output of the nodes is in {folder}") from None
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        raise KeyboardInterrupt("interrupted, every process has ended") from None
    shutil.rmtree(folder, ignore_errors=True)


class LaunchedNodes:
    """roslaunch process with the nodes of the launch file, on a private master.

    Args:
        arguments: Arguments {name: value} of the launch file.
        port: Port of the master.
        folder: Folder for the output of the nodes.
    """

    def __init__(self, arguments: Dict[str, str], port: int, folder: str):
        self._died = ""  # message about the first node that has died
        self._has_no_master = False
        self._is_ending = False
        # Before the master has started, roslaunch prints tracebacks if the machine is slow.
        self._lock = threading.Lock()  # guards the errors
        self._are_errors_shown = False
        self._errors: List[str] = []  # lines that are not shown yet
        assignments = [f"{argument_name}:={value}" for argument_name, value in arguments.items()]
        options = [f"--port={port}", "--sigint-timeout=2", "--sigterm-timeout=0.5"]
        with open(os.path.join(folder, "roslaunch.log"), "w", encoding="utf-8") as log_file:
            self._process = subprocess.Popen(
                ["roslaunch", *options, *LAUNCH_FILE, *assignments],
                stdout=log_file,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,  # After Ctrl-C, `stop` ends the process.
            )
        self._error_thread = threading.Thread(target=self._pass_errors_on, daemon=True)
        self._error_thread.start()

    def _pass_errors_on(self) -> None:
        """Print the stack's errors, and note a node that has died."""
        for line in self._process.stderr or ():
            match = DIED.search(line)
            if match and not self._died:
                self._died = f"{match.group(1)} has died"
            self._has_no_master = self._has_no_master or NO_MASTER in line
            with self._lock:
                if not self._are_errors_shown:
                    self._errors.append(line)
                elif not self._is_ending:  # roslaunch complains about nodes that end slowly.
                    print(line, end="", file=sys.stderr)

    def show_errors(self) -> None:
        """Print the errors so far, and from now on those that come."""
        with self._lock:
            self._are_errors_shown = True
            print(end="".join(self._errors), file=sys.stderr)
            self._errors.clear()

    def check(self) -> None:
        """Raise ApplrError if a node has died."""
        if self._died:
            raise ApplrError(self._died)
        if self._process.poll() is None:
            return
        self._error_thread.join(1.0)  # The last lines have the reason.
        if self._has_no_master:
            problem = "the ROS master did not start within 10 s"
            raise ApplrError(f"{problem}: end other programs, and try again")
        self.show_errors()
        raise ApplrError(self._died or "the stack has ended unexpectedly")

    def wait(self, part: str, condition: Callable[[], Any], pause: float = 0.02) -> None:
        """Wait until condition() is true because `part` is up.

        pause: interval between two calls of condition() [s].

        Raises:
            ApplrError: The part is not up after UP_WITHIN_S of wall time, or a node has died.
        """
        deadline = time.monotonic() + UP_WITHIN_S
        with announced(COMPILES.format(part), report, first=10.0):
            while not condition():
                self.check()
                if time.monotonic() > deadline:
                    raise ApplrError(f"{part} does not come up within {UP_WITHIN_S:g} s")
                time.sleep(pause)

    def stop(self) -> None:
        """End all processes: roslaunch ends the nodes, unless it does not end itself."""
        self._is_ending = True
        # Clients of this process would otherwise complain about the master that goes away.
        rospy.signal_shutdown("the program that started the stack has ended")
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(ENDED_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            report(f"roslaunch did not end within {ENDED_WITHIN_S:g} s: end its nodes yourself")
