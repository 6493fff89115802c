"""ROS for tests: a private master on a free port, and processes that use it, each ended by its pid.

Every test that needs rospy uses this module. rospy knows one master URI per process, so all tests
in a process share the master of `session()`. tests/conftest.py calls `close_session()` between test
files.
"""

import atexit
import contextlib
import functools
import os
import pkgutil
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from tests.support import ROOT
from tests.support.nursery import Nursery

# Prefix that interrupts a child even if this process is killed.
INTERRUPTED_WITH_US = ("setpriv", "--pdeathsig", "INT")
VARIABLES = ("ROS_MASTER_URI", "ROS_IP", "ROS_LOG_DIR")
GENERATED = ROOT / ".applr" / "catkin_ws" / "devel" / "lib" / "python3" / "dist-packages"


class Child:
    """Started process. `log` is the file (Path) with its output."""

    def __init__(self, process, log):
        self.process = process
        self.log = log
        self.pid = process.pid

    @property
    def text(self):
        """Output of the process so far."""
        return self.log.read_text(errors="replace")

    def alive(self):
        """Return whether the process has not ended."""
        return self.process.poll() is None

    def until(self, condition):
        """Wait until the process has printed a text, or until condition() is true, and return the
        value.

        Raises:
            AssertionError: The process ended first, or hangs; the message has its output.
        """
        if callable(condition):
            holds = condition
            expected = "it"
        else:
            holds = lambda: condition in self.text  # noqa: E731
            expected = condition
        try:
            result = wait_for(lambda: not self.alive() or holds(), expected)
            assert self.alive(), "it has ended"
        except AssertionError as late:
            raise AssertionError("%s\n%s" % (late, self.text)) from None
        return result

    def freeze(self):
        """Stop the process with SIGSTOP: it lives, and answers nobody."""
        os.kill(self.pid, signal.SIGSTOP)

    def thaw(self):
        """Let a frozen process go on."""
        if self.alive():
            os.kill(self.pid, signal.SIGCONT)

    def kill(self):
        """Kill the process with SIGKILL, as a crash would end it."""
        if self.alive():
            os.kill(self.pid, signal.SIGKILL)
        self.process.wait(LONGEST)

    def end(self):
        """Send SIGINT, as Ctrl-C does, and SIGKILL if the process hangs. Return the exit status."""
        if self.alive():
            self.thaw()
            os.kill(self.pid, signal.SIGINT)
            try:
                self.process.wait(LONGEST)
            except subprocess.TimeoutExpired:
                self.kill()
        return self.process.returncode


def started(args, env, log):
    """Start a command and return its Child."""
    command = [*INTERRUPTED_WITH_US, *map(str, args)]
    # The process has the file open, too, after this block.
    with open(log, "wb") as log_file:
        process = subprocess.Popen(
            command,
            env=env,
            cwd=ROOT,
            start_new_session=True,
            stdout=log_file,
            stderr=subprocess.STDOUT,
        )
    return Child(process, log)


class RosMaster:
    """ROS master on a given or free port, with its child processes. Use as a context manager or
    call close().

    Attributes:
        env: Environment of processes that join the master.
    """

    def __init__(self, port=None):
        self.folder = Path(tempfile.mkdtemp(prefix="applr_ros_"))
        self.port = port or free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self.env = dict(
            os.environ,
            ROS_MASTER_URI=self.uri,
            ROS_IP="127.0.0.1",
            PYTHONUNBUFFERED="1",
            ROS_LOG_DIR=str(self.folder),
            PYTHONPATH=os.pathsep.join(
                [str(ROOT), str(GENERATED), os.environ.get("PYTHONPATH", "")]
            ).rstrip(os.pathsep),
        )
        self.env.pop("ROS_HOSTNAME", None)
        self._children = []
        self._nodes = []
        self._master = started(
            ["rosmaster", "--core", "-p", self.port], self.env, self.folder / "master.log"
        )
        self._master.until(lambda: _answers(self.port))

    def spawn(self, *args, **env):
        """Start a program that uses the master, with additional environment variables `env`, and
        return its Child.
        """
        # A program of `rosrun` or `roslaunch` is named by what follows it.
        program_name = args[0] if len(args) == 1 else args[1]
        return self._keep(started, args, env, str(program_name))

    def node(self, script, *args, constants=None, **env):
        """Fork a program of `rosrun applr_ros1`, named without ".py", or the main() of a module;
        return its Child.

        constants: {"module.NAME": value} of constants that are replaced in the program.
        """
        child = self._keep(
            functools.partial(forked, constants=constants or {}), (script, *args), env, script
        )
        # A remapping of __name renames the node.
        node_name = script
        for argument in map(str, args):
            if argument.startswith("__name:="):
                node_name = argument[len("__name:=") :]
        self._nodes.append((node_name, child))
        return child

    def _keep(self, start, args, env, name):
        """Return start(args, environment, log file), a Child that close() will end."""
        # Numbered, because a program may be started several times.
        log_file = self.folder / f"{len(self._children)}_{Path(name).name}.log"
        child = start(args, dict(self.env, **env), log_file)
        self._children.append(child)
        return child

    def forget_ended(self):
        """Delete the parameters of nodes that have ended, so that the next node of that name does
        not inherit them.
        """
        import rospy

        # Two nodes may have had one name, one after the other.
        living_nodes = [(name, child) for name, child in self._nodes if child.alive()]
        ended_names = set(dict(self._nodes)) - set(dict(living_nodes))
        for node_name in ended_names:
            if rospy.has_param("/" + node_name):
                rospy.delete_param("/" + node_name)
        self._nodes = living_nodes

    def close(self):
        """End the programs, the latest first, and the master."""
        for child in reversed(self._children):
            child.end()
        self._master.end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()


_session = None
_port = None
_nursery = None
_joined = []  # functions that end the topics and services of this process


def forked(words, env, log, constants):
    """Fork a program from the nursery and return its Child."""
    global _nursery
    if _nursery is None:
        _nursery = Nursery(env, os.devnull)
        atexit.register(_nursery.close)
    return Child(_nursery.fork(words, env, log, constants), log)


def session():
    """Return the master of the running tests, with this process as one of its nodes (rospy is
    initialised).
    """
    global _session, _port
    if _session is None:
        import rospy

        _session = RosMaster(_port)
        _port = _session.port
        for variable in VARIABLES:
            os.environ[variable] = _session.env[variable]
        os.environ.pop("ROS_HOSTNAME", None)
        if not rospy.core.is_initialized():
            rospy.init_node("pytest", anonymous=True, disable_signals=True)
            _remember(rospy.topics.Topic, "unregister")
            _remember(rospy.Service, "shutdown")
            atexit.register(rospy.signal_shutdown, "tests are over")
            atexit.register(close_session)
    return _session


def _remember(kind, end):
    """Remember the method `end` of each object of the class `kind` that is created from now on."""
    original_init = kind.__init__

    @functools.wraps(original_init)
    def init(self, *args, **kwargs):
        original_init(self, *args, **kwargs)
        _joined.append(getattr(self, end))

    kind.__init__ = init


def forget_ended():
    """Delete the parameters of ended nodes from the session's parameter server."""
    if _session is not None:
        _session.forget_ended()


def close_session():
    """End the master, its nodes and this process's topics; the next tests get a master without
    parameters.
    """
    global _session
    if _session is not None:
        while _joined:
            _joined.pop()()
        _session.close()
        _session = None
        for variable in VARIABLES:
            del os.environ[variable]


def use_generated():
    """Make applr_ros1.cfg (generated by catkin) importable in this process."""
    import applr_ros1

    if GENERATED.is_dir() and str(GENERATED) not in sys.path:
        sys.path.append(str(GENERATED))
    applr_ros1.__path__ = pkgutil.extend_path(applr_ros1.__path__, "applr_ros1")


use_generated()


def free_port():
    """Return a TCP port that nobody listens on now, and that the system gives to nobody else."""
    # It is below those that Linux gives to whoever asks for any port. One of these might go to a
    # node of another worker before it is used here, or between two masters of this process.
    port = 20000 + secrets.randbelow(12000)
    return free_port() if _answers(port) else port


# Time after which a process counts as hanging; includes compilation of the kernels [s]
LONGEST = 300.0


class Kept:
    """Stopwatch for the time that this process and its children spent waiting for a processor on a
    busy machine.

    Tests add this time to their wall-time limits, which are for an idle machine.
    """

    def __init__(self):
        self._since = self._latest = self._delays()

    @staticmethod
    def _delays():
        """Return {(process, thread): time for which it was ready but did not run [ns]}."""
        delays = {}
        this_process = psutil.Process()
        for process in [this_process, *this_process.children(recursive=True)]:
            for schedstat in Path("/proc/%d/task" % process.pid).glob("*/schedstat"):
                thread = (process.pid, schedstat.parent.name)
                with contextlib.suppress(OSError):  # the thread has ended
                    # Time on a processor, time of waiting for one, and number of turns
                    delays[thread] = int(schedstat.read_text().split()[1])
        return delays

    def waiting(self):
        """Return the longest waiting time [s] of a thread since construction. An ended thread keeps
        its last value.
        """
        self._latest = {**self._latest, **self._delays()}
        waits_ns = [delay - self._since.get(thread, 0) for thread, delay in self._latest.items()]
        return 1e-9 * max(waits_ns)


def wait_for(condition, what):
    """Poll until condition() is true and return its value. Raise AssertionError after LONGEST.

    This limit only catches hanging processes; tests of durations measure them separately.
    """
    began = time.monotonic()
    while True:
        result = condition()
        if result:
            return result
        assert time.monotonic() - began < LONGEST, "%s: not within %g s" % (what, LONGEST)
        time.sleep(0.01)


def _answers(port):
    """Return whether somebody listens on a port of this machine."""
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex(("127.0.0.1", port)) == 0
