"""Compilation of all kernels of the robot's side, so that nodes never compile while they drive.

`./applr` runs this program if kernels may be missing, and so does `catkin_make install`. The
program prints the folder of the cache, which common/kernel_cache.py describes.
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
from applr_ros1.common.kernel_cache import cache_folder
from applr_ros1.common.progress import announced
from applr_ros1.drives import simulate
from applr_ros1.drives.end_rules import Rules
from applr_ros1.monitor.monitor import warm_up as warm_up_monitor
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.movers.prediction import warm_up as warm_up_tracker
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS
from applr_ros1.planner.warm_up import warm_up as warm_up_planner
from applr_ros1.policy.methods import RandomParameters
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.policy.pilot import Pilot
from applr_ros1.robots import JACKAL, Robot, load
from applr_ros1.robots.robot_world import world_of
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from sim_bridge.simulator import warm_up as warm_up_simulator

Part = Tuple[str, Callable[[], None]]  # name, function that compiles
# The longest first. The second planner comes last, because it shares kernels with the first: two
# processes that compiled both at once took a seventh more time.
PARTS: Tuple[Part, ...] = (
    (f"move_base with {LOCAL_PLANNERS[0]}", lambda: warm_up_planner(LOCAL_PLANNERS[0])),
    ("the simulators", lambda: _simulators()),
    ("the collision monitor", lambda: warm_up_monitor(MonitorSettings.of(JACKAL))),
    ("the tracker of moving obstacles", warm_up_tracker),
    (f"move_base with {LOCAL_PLANNERS[1]}", lambda: warm_up_planner(LOCAL_PLANNERS[1])),
)
# A warm-up of a part cannot know everything that a drive needs: a base that brakes in front of an
# obstacle, an obstacle that leaves the costmap, the costs after a change of parameters. These
# drives compile the rest.
DRIVES: Tuple[Part, ...] = (
    ("a drive with TrajectoryPlannerROS", lambda: drive(JACKAL)),
    ("a drive with DWAPlannerROS", lambda: drive(load("turtlebot3_waffle_pi"))),
)
WORLD = "dynamic:0"  # a room with moving obstacles
SEED = 0  # seed of a drive
DRIVE_S = 30.0  # longest simulated time of a drive [s]
DECISION_S = 1.0  # time between two changes of the parameters [s]
# Wall time before the first progress line, longer than loading compiled kernels takes [s]
QUIET_S = 5.0


def main() -> int:
    """Run the program. Return exit status 0 if all kernels are compiled."""
    return run_main(_compile, "applr")


def _compile() -> None:
    """Compile the parts, then the rest, in as many processes as there are processors."""
    fork = multiprocessing.get_context("fork")
    process_count = len(os.sched_getaffinity(0))
    # A process ends without a traceback at Ctrl-C.
    pool = ProcessPoolExecutor(process_count, fork, signal.signal, (signal.SIGINT, signal.SIG_DFL))
    with announced("compiling kernels", _report, first=QUIET_S), pool:
        # The drives begin when all parts are in the cache: they would otherwise compile the same
        # kernels again.
        list(pool.map(_compile_part, range(len(PARTS))))
        list(pool.map(_compile_drive, range(len(DRIVES))))
    print(cache_folder())


def _compile_part(number: int) -> None:
    _, compile_part = PARTS[number]
    compile_part()


def _compile_drive(number: int) -> None:
    _, run_drive = DRIVES[number]
    run_drive()


def _report(text: str) -> None:
    print(f"applr: {text}", file=sys.stderr, flush=True)


def _simulators() -> None:
    world = worlds.load("generated:0")
    for simulator_name in sim_bridge.NAMES:
        simulator = sim_bridge.make(simulator_name)
        warm_up_simulator(simulator, world)
        simulator.close()


def drive(robot: Robot) -> None:
    """Drive the whole stack of a robot among moving obstacles, with random parameters."""
    world = world_of(WORLD, robot)
    simulator = sim_bridge.make("kinematic", robot)
    parameters = robot.parameters()
    parameters["applr"] = {**parameters.get("applr", {}), "movers": True}
    stack = Stack(robot, MoveBase(parameters), monitor=True)
    pilot = Pilot(RandomParameters(space_of(robot)), robot, DECISION_S)
    simulate.drive(SimulatedRobot(simulator, stack), world, SEED, pilot, Rules(limit=DRIVE_S))
    simulator.close()


if __name__ == "__main__":
    sys.exit(main())
