"""Compiles all numeric kernels of the robot's side, so that the nodes start at once afterwards.

`./applr setup` and `catkin_make install` run it. The machine code goes to the cache that common/kernels.py describes.
"""

from __future__ import annotations

import sys
from typing import Callable, Tuple

import sim_bridge
import worlds
from applr_ros1.common.errors import run_main
from applr_ros1.common.progress import announced
from applr_ros1.monitor.monitor import warm_up as warm_up_monitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.movers.tracker import warm_up as warm_up_tracker
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS
from applr_ros1.planner.warm_up import warm_up as warm_up_planner
from applr_ros1.robots import JACKAL
from sim_bridge.simulator import warm_up as warm_up_simulator

PARTS: Tuple[Tuple[str, Callable[[], None]], ...] = (
    ("the simulators", lambda: _simulators()),
    ("the collision monitor", lambda: warm_up_monitor(MonitorSettings.of(JACKAL))),
    ("the tracker of moving obstacles", warm_up_tracker),
    (f"move_base with {LOCAL_PLANNERS[0]}", lambda: warm_up_planner(LOCAL_PLANNERS[0])),
    (f"move_base with {LOCAL_PLANNERS[1]}", lambda: warm_up_planner(LOCAL_PLANNERS[1])),
)


def main() -> int:
    """The command. Exit status 0 when all kernels are compiled."""
    return run_main(_compile, "applr")


def _compile() -> None:
    for name, compile_part in PARTS:
        with announced(f"compiling the kernels of {name} (up to a minute)", _say, first=0.5):
            compile_part()


def _say(line: str) -> None:
    print("applr: " + line, file=sys.stderr, flush=True)


def _simulators() -> None:
    world = worlds.load("generated:0")
    for name in sim_bridge.NAMES:
        simulator = sim_bridge.make(name)
        warm_up_simulator(simulator, world)
        simulator.close()


if __name__ == "__main__":
    sys.exit(main())
