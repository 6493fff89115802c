"""Compiles all numeric kernels of the robot's side, so that the nodes start at once afterwards.

`./applr` runs it where kernels may be missing, and so does `catkin_make install`. The machine code goes to the cache
that common/kernels.py describes, whose folder is printed.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from multiprocessing.connection import wait
from typing import Any, Callable, List, Tuple

import sim_bridge
import worlds
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.kernels import cache_folder
from applr_ros1.common.progress import NEXT_LINE_S
from applr_ros1.monitor.monitor import warm_up as warm_up_monitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.movers.tracker import warm_up as warm_up_tracker
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS
from applr_ros1.planner.warm_up import warm_up as warm_up_planner
from applr_ros1.robots import JACKAL
from sim_bridge.simulator import warm_up as warm_up_simulator

PARTS: Tuple[Tuple[str, Callable[[], None]], ...] = (  # the longest first; both planners share kernels
    (f"move_base with {LOCAL_PLANNERS[0]}", lambda: warm_up_planner(LOCAL_PLANNERS[0])),
    ("the simulators", lambda: _simulators()),
    (f"move_base with {LOCAL_PLANNERS[1]}", lambda: warm_up_planner(LOCAL_PLANNERS[1])),
    ("the tracker of moving obstacles", warm_up_tracker),
    ("the collision monitor", lambda: warm_up_monitor(MonitorSettings.of(JACKAL))),
)
QUIET_S = 5.0  # of wall time before the first line: loading alone takes less


def main() -> int:
    """The command. Exit status 0 when all kernels are compiled."""
    return run_main(_compile, "applr")


def _compile() -> None:
    """Compile the parts in as many processes as there are processors, and say how far that is."""
    processes, folder = len(os.sched_getaffinity(0)), cache_folder()
    context, began, before = multiprocessing.get_context("fork"), time.monotonic(), _files(folder)
    left, due = list(PARTS), began + QUIET_S
    running: List[Any] = []
    while left or running:
        while left and len(running) < processes:
            name, compile_part = left.pop(0)
            running.append(context.Process(target=_quietly, args=(compile_part,), name=name, daemon=True))
            running[-1].start()
        wait([process.sentinel for process in running], timeout=max(0.0, due - time.monotonic()))
        for process in [process for process in running if not process.is_alive()]:
            running.remove(process)
            if process.exitcode:
                for other in running:
                    other.kill()
                raise ApplrError(f"the kernels of {process.name} could not be compiled (status {process.exitcode})")
        if time.monotonic() >= due:
            due += NEXT_LINE_S
            done = f"{len(PARTS) - len(left) - len(running)} of {len(PARTS)} parts, {_files(folder) - before} kernels"
            print(f"applr: compiling kernels: {done} in {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    print(folder)


def _quietly(compile_part: Callable[[], None]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process ends the others
    compile_part()


def _files(folder: str) -> int:
    return sum("-" in name for name in os.listdir(folder)) if folder else 0


def _simulators() -> None:
    world = worlds.load("generated:0")
    for name in sim_bridge.NAMES:
        simulator = sim_bridge.make(name)
        warm_up_simulator(simulator, world)
        simulator.close()


if __name__ == "__main__":
    sys.exit(main())
