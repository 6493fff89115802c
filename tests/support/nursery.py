"""Nursery: process from which the nodes of tests are forked. It has imported all nodes.

The nursery loads a node's kernels at the first start of this node. A forked node runs as its
command would, but without imports and loading of kernels, which take most of the processor time.
Its parent is the process of the tests, which receives the exit status. Programs in tests/launch and
tests/nodes, and the process that the collision monitor's guard starts, are ordinary commands and
not forked from the nursery.
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

# options of prctl: PR_SET_CHILD_SUBREAPER and PR_SET_PDEATHSIG
ADOPT = 36
DIES_WITH_PARENT = 1
IMPORTED = "applr", "collision_monitor", "move_base", "movers", "sim_bridge", "send_goal"
PARTS = {  # kernels (nodes/tools/compile_kernels.py) that the first start of each node loads
    "move_base": "move_base with base_local_planner/TrajectoryPlannerROS",
    "movers": "the tracker of moving obstacles",
    "sim_bridge": "the simulators",
}


def prctl(option, value):
    """Call Linux's prctl for this process."""
    ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


class Forked:
    """Forked process, with the part of subprocess.Popen's interface that the tests use."""

    def __init__(self, pid):
        self.pid = pid
        self.returncode = None

    def poll(self):
        """Return the exit status, minus the number of a signal that ended it, or None."""
        if self.returncode is not None:
            return self.returncode
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if pid == 0:
            return None
        if os.WIFSIGNALED(status):
            self.returncode = -os.WTERMSIG(status)
        else:
            self.returncode = os.WEXITSTATUS(status)
        return self.returncode

    def wait(self, timeout):
        """Wait for the end, at most `timeout` [s], and return the exit status."""
        deadline = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(0.005)
        return self.returncode


class Nursery:
    """Handle of the nursery in the process of the tests.

    Args:
        env: Environment of the nursery.
        log: File for its stderr.
    """

    def __init__(self, env, log):
        # Forked nodes, whose parents end at once, become children of this process.
        prctl(ADOPT, 1)
        with open(log, "wb") as log_file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(os.getpid())],
                env=env,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log_file,
                start_new_session=True,
            )

    def fork(self, words, env, log, constants):
        """Start a program of `rosrun applr_ros1`, or the main() of a module, and return its Forked.

        Args:
            words: Command line.
            env: Environment.
            log: File for its output.
            constants: {"module.NAME": value} of constants that are replaced in the program.
        """
        order = {
            "words": list(map(str, words)),
            "env": env,
            "log": str(log),
            "constants": constants,
        }
        self._process.stdin.write(json.dumps(order).encode() + b"\n")
        self._process.stdin.flush()
        return Forked(int(self._process.stdout.readline()))

    def close(self):
        self._process.stdin.close()
        self._process.wait()


def main():
    """Fork a process for each order on stdin. The forked process leaves the loop and runs the
    program.
    """
    from applr_ros1.nodes.tools import compile_kernels

    tests_pid = int(sys.argv[1])
    unloaded_parts = dict(compile_kernels.PARTS)
    for node_name in IMPORTED:
        importlib.import_module(NODES[node_name])
    importlib.import_module("tests.support.nodes")
    # Every node that runs a kernel would otherwise import numba anew.
    importlib.import_module("numba")
    for line in sys.stdin:
        order = json.loads(line)
        part_name = PARTS.get(order["words"][0])
        load_part = unloaded_parts.pop(part_name, None)
        if load_part:
            load_part()
        # Objects that the collector does not touch stay shared with the forked processes.
        gc.freeze()
        child_pid = os.fork()
        if child_pid:
            os.waitpid(child_pid, 0)
            continue
        if os.fork():
            # The tests' process, a subreaper, becomes the parent of the grandchild.
            os._exit(0)
        return become(order, tests_pid)
    return None


def become(order, parent):
    """Run a program in this process, as its command would."""
    import rospy

    # The tests' process must be the parent before the signal of its death is asked for.
    while os.getppid() != parent:
        time.sleep(0.001)
    prctl(DIES_WITH_PARENT, signal.SIGINT)
    os.setsid()

    # The process ID is the nursery's answer; from then on the output goes to the log.
    log_descriptor = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.write(1, b"%d\n" % os.getpid())
    for descriptor in (1, 2):
        os.dup2(log_descriptor, descriptor)
    # The nursery's orders on stdin are not for the node.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.environ.clear()
    os.environ.update(order["env"])
    sys.argv = order["words"]
    # Rospy read the nursery's arguments at its import.
    rospy.names.reload_mappings(sys.argv)
    rospy.names._set_caller_id(rospy.names.get_ros_namespace() + "unnamed")
    for full_name, test_value in order["constants"].items():
        module_name, constant = full_name.rsplit(".", 1)
        # A constant that has been renamed in the product would be replaced without effect.
        assert hasattr(importlib.import_module(module_name), constant), full_name
        setattr(sys.modules[module_name], constant, test_value)
    program = sys.argv[0]
    run_script({**NODES, **COMMANDS}.get(program, program), node=program in NODES)


if __name__ == "__main__":
    main()
