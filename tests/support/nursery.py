"""A process that has imported all nodes and loaded their kernels once, and from which each node that a test starts is
forked: it runs as its command would, without what every start costs anew, which is most of its processor time.

A node's parent is the process of the tests, which has its exit status. Real starts are those of tests/launch,
tests/nodes and the collision monitor's own process.
"""

import ctypes
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import time

from applr_ros1.common.errors import run_script
from applr_ros1.scripts.__main__ import COMMANDS, NODES

ADOPT, DIES_WITH_PARENT = 36, 1  # of prctl: PR_SET_CHILD_SUBREAPER and PR_SET_PDEATHSIG
IMPORTED = "applr", "collision_monitor", "move_base", "movers", "sim_bridge", "send_goal"
PARTS = {  # whose kernels (nodes/tools/compile_kernels.py) a node's first start loads
    "move_base": "move_base with base_local_planner/TrajectoryPlannerROS",
    "movers": "the tracker of moving obstacles",
    "sim_bridge": "the simulators",
}


def prctl(option, value):
    ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


class Forked:
    """A forked process, with what its users need of subprocess.Popen."""

    def __init__(self, pid):
        self.pid, self.returncode = pid, None

    def poll(self):
        if self.returncode is None and (found := os.waitpid(self.pid, os.WNOHANG))[0]:
            self.returncode = -os.WTERMSIG(found[1]) if os.WIFSIGNALED(found[1]) else os.WEXITSTATUS(found[1])
        return self.returncode

    def wait(self, timeout):
        until = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > until:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(0.005)
        return self.returncode


class Nursery:
    """The process, as the tests' process sees it. env: its environment; where it has printed something is `log`."""

    def __init__(self, env, log):
        prctl(ADOPT, 1)
        with open(log, "wb") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(os.getpid())],
                env=env,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                start_new_session=True,
            )

    def fork(self, words, env, log, constants):
        """Starts a program of `rosrun applr_ros1`, or a module's main(), by its words; returns its Forked.

        constants: {"module.NAME": value} that it has instead of its own.
        """
        order = {"words": list(map(str, words)), "env": env, "log": str(log), "constants": constants}
        self._process.stdin.write(json.dumps(order).encode() + b"\n")
        self._process.stdin.flush()
        return Forked(int(self._process.stdout.readline()))

    def close(self):
        self._process.stdin.close()
        self._process.wait()


def main():
    """Forks what is ordered on stdin; who is forked leaves the loop and becomes the program."""
    from applr_ros1.nodes.tools import compile_kernels

    parent, parts = int(sys.argv[1]), dict(compile_kernels.PARTS)
    for name in IMPORTED:
        importlib.import_module(NODES[name])
    importlib.import_module("tests.support.fake_move_base")
    for line in sys.stdin:
        order = json.loads(line)
        part = parts.pop(PARTS.get(order["words"][0]), None)
        if part:
            part()
        gc.freeze()
        child = os.fork()
        if child:
            os.waitpid(child, 0)
            continue
        if os.fork():
            os._exit(0)  # who was forked last has the tests' process as its parent now
        return become(order, parent)
    return None


def become(order, parent):
    """Runs a program in this process, as its command would."""
    import rospy

    while os.getppid() != parent:
        time.sleep(0.001)
    prctl(DIES_WITH_PARENT, signal.SIGINT)
    os.setsid()
    log = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.write(1, b"%d\n" % os.getpid())
    for here in (1, 2):
        os.dup2(log, here)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.environ.clear()
    os.environ.update(order["env"])
    sys.argv = order["words"]
    rospy.names.reload_mappings(sys.argv)  # rospy has read them when it was imported
    rospy.names._set_caller_id(rospy.names.get_ros_namespace() + "unnamed")
    for place, value in order["constants"].items():
        module, _, name = place.rpartition(".")
        assert hasattr(importlib.import_module(module), name), place
        setattr(sys.modules[module], name, value)
    name = sys.argv[0]
    run_script({**NODES, **COMMANDS}.get(name, name), node=name in NODES)


if __name__ == "__main__":
    main()
