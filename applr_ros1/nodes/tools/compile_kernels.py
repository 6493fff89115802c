"""Compilation of all kernels of the robot's side, so that nodes start quickly afterwards.

`./applr` runs this program if kernels may be missing, and so does `catkin_make install`. The program prints the
folder of the cache, which common/kernels.py describes.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import Callable, Tuple

import sim_bridge
import worlds
from applr_ros1.common.errors import run_main
from applr_ros1.common.kernels import cache_folder
from applr_ros1.common.progress import announced
from applr_ros1.monitor.monitor import warm_up as warm_up_monitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.movers.tracker import warm_up as warm_up_tracker
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS
from applr_ros1.planner.warm_up import warm_up as warm_up_planner
from applr_ros1.robots import JACKAL
from sim_bridge.simulator import warm_up as warm_up_simulator

PARTS: Tuple[Tuple[str, Callable[[], None]], ...] = (  # (name, function that compiles), longest first
    (f"move_base with {LOCAL_PLANNERS[0]}", lambda: warm_up_planner(LOCAL_PLANNERS[0])),
    ("the simulators", lambda: _simulators()),
    (f"move_base with {LOCAL_PLANNERS[1]}", lambda: warm_up_planner(LOCAL_PLANNERS[1])),
    ("the tracker of moving obstacles", warm_up_tracker),
    ("the collision monitor", lambda: warm_up_monitor(MonitorSettings.of(JACKAL))),
)
QUIET_S = 5.0  # wall time before the first progress line, longer than loading compiled kernels takes [s]


def main() -> int:
    """Run the program. Return exit status 0 if all kernels are compiled."""
    return run_main(_compile, "applr")


def _compile() -> None:
    """Compile the parts in as many processes as there are processors."""
    fork, processes = multiprocessing.get_context("fork"), len(os.sched_getaffinity(0))
    pool = ProcessPoolExecutor(processes, fork, signal.signal, (signal.SIGINT, signal.SIG_DFL))  # No tracebacks.
    with announced("compiling kernels", _report, first=QUIET_S), pool:
        list(pool.map(_compile_part, range(len(PARTS))))
    print(cache_folder())


def _compile_part(number: int) -> None:
    PARTS[number][1]()


def _report(text: str) -> None:
    print(f"applr: {text}", file=sys.stderr, flush=True)


def _simulators() -> None:
    world = worlds.load("generated:0")
    for name in sim_bridge.NAMES:
        simulator = sim_bridge.make(name)
        warm_up_simulator(simulator, world)
        simulator.close()


if __name__ == "__main__":
    sys.exit(main())
