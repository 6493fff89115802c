"""ROS for tests: a master of one's own on a free port, and processes beside it, each ended by its own pid.

Used by every test that needs rospy. rospy knows one master URI per process, so all tests of one process share that of
`session()`; tests/conftest.py calls `close_session()` between test files.
"""

import atexit
import contextlib
import functools
import os
import pkgutil
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

INTERRUPTED_WITH_US = ("setpriv", "--pdeathsig", "INT")  # also when this process is killed
VARIABLES = ("ROS_MASTER_URI", "ROS_IP", "ROS_LOG_DIR")
GENERATED = ROOT / ".applr" / "catkin_ws" / "devel" / "lib" / "python3" / "dist-packages"


class Child:
    """A started process. `log` (a Path) holds what it prints."""

    def __init__(self, process, log):
        self.process, self.log, self.pid = process, log, process.pid

    @property
    def text(self):
        return self.log.read_text(errors="replace")

    def alive(self):
        return self.process.poll() is None

    def until(self, condition):
        """Waits until it has printed some words, or until condition() is true; returns its value.

        AssertionError with all that it has printed where it ends before, or hangs.
        """
        holds = condition if callable(condition) else lambda: condition in self.text
        try:
            value = wait_for(lambda: not self.alive() or holds(), "it" if callable(condition) else condition)
            assert self.alive(), "it has ended"
        except AssertionError as late:
            raise AssertionError("%s\n%s" % (late, self.text)) from None
        return value

    def freeze(self):
        os.kill(self.pid, signal.SIGSTOP)

    def thaw(self):
        if self.alive():
            os.kill(self.pid, signal.SIGCONT)

    def kill(self):
        """SIGKILL, as a crash."""
        if self.alive():
            os.kill(self.pid, signal.SIGKILL)
        self.process.wait(LONGEST)

    def end(self):
        """SIGINT as Ctrl-C does, SIGKILL where it hangs. Returns the exit status."""
        if self.alive():
            self.thaw()
            os.kill(self.pid, signal.SIGINT)
            try:
                self.process.wait(LONGEST)
            except subprocess.TimeoutExpired:
                self.kill()
        return self.process.returncode


def started(args, env, log):
    """The Child of a command, which is executed."""
    with open(log, "wb") as file:
        command = [*INTERRUPTED_WITH_US, *map(str, args)]
        output = {"stdout": file, "stderr": subprocess.STDOUT}
        return Child(subprocess.Popen(command, env=env, cwd=ROOT, start_new_session=True, **output), log)


class RosMaster:
    """A ROS master on the given or a free port, and its children.

    env: what a process needs to join it. Use as a context manager or call close().
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
            PYTHONPATH=os.pathsep.join([str(ROOT), str(GENERATED), os.environ.get("PYTHONPATH", "")]).rstrip(
                os.pathsep
            ),
        )
        self.env.pop("ROS_HOSTNAME", None)
        self._children, self._nodes = [], []
        self._master = started(["rosmaster", "--core", "-p", self.port], self.env, self.folder / "master.log")
        self._master.until(lambda: _answers(self.port))

    def spawn(self, *args, **env):
        """Starts a program beside the master; env: additional environment variables. Returns its Child."""
        return self._keep(started, args, env, str(args[-1 if len(args) == 1 else 1]))

    def node(self, script, *args, constants=None, **env):
        """Forks a program of `rosrun applr_ros1`, named without ".py", or a module's main(). Returns its Child.

        constants: {"module.NAME": value} that it has instead of its own.
        """
        child = self._keep(functools.partial(forked, constants=constants or {}), (script, *args), env, script)
        self._nodes.append((next((a[8:] for a in map(str, args) if a.startswith("__name:=")), script), child))
        return child

    def _keep(self, start, args, env, name):
        log = self.folder / f"{len(self._children)}_{Path(name).name}.log"
        self._children.append(start(args, dict(self.env, **env), log))
        return self._children[-1]

    def forget_ended(self):
        """Deletes the parameters of scripts' nodes that have ended: the next one of that name begins with its own."""
        import rospy

        living = {name for name, child in self._nodes if child.alive()}
        for name in {name for name, _ in self._nodes} - living:
            if rospy.has_param("/" + name):
                rospy.delete_param("/" + name)
        self._nodes = [(name, child) for name, child in self._nodes if child.alive()]

    def close(self):
        for child in reversed(self._children):
            child.end()
        self._master.end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()


_session, _port, _nursery = None, None, None
_joined = []  # topics and services of this process


def forked(words, env, log, constants):
    """The Child of a program that is forked from the nursery."""
    global _nursery
    if _nursery is None:
        _nursery = Nursery(env, os.devnull)
        atexit.register(_nursery.close)
    return Child(_nursery.fork(words, env, log, constants), log)


def session():
    """The master of the tests that run now, with this process as a node of it (rospy is initialised)."""
    global _session, _port
    if _session is None:
        import rospy

        _session = RosMaster(_port)
        _port = _session.port
        for key in VARIABLES:
            os.environ[key] = _session.env[key]
        os.environ.pop("ROS_HOSTNAME", None)
        if not rospy.core.is_initialized():
            rospy.init_node("pytest", anonymous=True, disable_signals=True)
            _remember(rospy.topics.Topic, "unregister")
            _remember(rospy.Service, "shutdown")
            atexit.register(rospy.signal_shutdown, "tests are over")
            atexit.register(close_session)
    return _session


def _remember(kind, end):
    """Keeps what ends each object of a class from now on."""
    make = kind.__init__

    @functools.wraps(make)
    def init(self, *args, **kwargs):
        make(self, *args, **kwargs)
        _joined.append(getattr(self, end))

    kind.__init__ = init


def forget_ended():
    """What ended nodes have left on the session's parameter server goes."""
    if _session is not None:
        _session.forget_ended()


def close_session():
    """Ends the master, its nodes and what this process has on it; the next tests get a master without parameters."""
    global _session
    if _session is not None:
        while _joined:
            _joined.pop()()
        _session.close()
        _session = None
        for key in VARIABLES:
            del os.environ[key]


def use_generated():
    """Makes applr_ros1.cfg (generated by catkin) importable in this process."""
    import applr_ros1

    if GENERATED.is_dir() and str(GENERATED) not in sys.path:
        sys.path.append(str(GENERATED))
    applr_ros1.__path__ = pkgutil.extend_path(applr_ros1.__path__, "applr_ros1")


use_generated()


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


LONGEST = 300.0  # s before something counts as hanging; the planner's kernels are compiled in that


class Kept:
    """The time for which a busy machine has kept this process and those below it waiting for a processor.

    What a test allows in wall time it allows beside that, so that its limit can be a quiet machine's.
    """

    def __init__(self):
        self._since = self._newest = self._delays()

    @staticmethod
    def _delays():
        """{(process, thread): time [ns] that it has been ready to run and did not}."""
        found = {}
        for process in [psutil.Process(), *psutil.Process().children(recursive=True)]:
            for file in Path("/proc/%d/task" % process.pid).glob("*/schedstat"):
                with contextlib.suppress(OSError):  # it has ended
                    found[process.pid, file.parent.name] = int(file.read_text().split()[1])
        return found

    def waiting(self):
        """Return the time [s] since this was made, of the thread that waited most; of one that ended as last seen."""
        self._newest = {**self._newest, **self._delays()}
        return 1e-9 * max(delay - self._since.get(thread, 0) for thread, delay in self._newest.items())


def wait_for(condition, what):
    """Polls until condition() is true and returns its value; AssertionError after LONGEST: it is for what hangs.

    How long something takes is measured beside it.
    """
    began = time.monotonic()
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() - began < LONGEST, "%s: not within %g s" % (what, LONGEST)
        time.sleep(0.01)


def _answers(port):
    with socket.socket() as s:
        s.settimeout(0.5)
        return s.connect_ex(("127.0.0.1", port)) == 0
