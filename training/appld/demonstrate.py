"""Records a scripted demonstration for APPLD, in simulation and without ROS.

Run it as `rosrun applr_ros1 demonstrate.py BAG` or `python -m training.appld.demonstrate BAG`.
The demonstrator is training/appld/scripted_driver.py. The bag's metadata name it.
"""

from __future__ import annotations

import sys
from typing import Optional, Sequence, Union

import numpy as np

import sim_bridge
from applr_ros1.common.angles import Pose, Twist
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.extras import extra
from applr_ros1.common.scan import LaserScan
from applr_ros1.drives import simulate
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import REACHED, Drive
from applr_ros1.drives.end_rules import Rules
from applr_ros1.planner.state_machine import Cycle
from applr_ros1.robots.robot_world import world_of
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Step
from sim_bridge.simulator import Simulator
from training.common.command_line import AnyRobot, Seed, SimulatorName, run_command
from training.common.options import Options, argument, option
from worlds import World

with extra(__name__):
    from training.appld.scripted_driver import NAME, Demonstrator
    from training.bags.write import BagWriter

# The demonstrator knows its true place, and gives up after some time.
RULES = Rules(ends_at_tolerance=False, limit=200.0)


class DemonstrateOptions(Options):
    """Demonstration to record."""

    bag: str = argument("Bag to write (.bag); it must not exist.")
    world: str = option("physical_course", "World to drive in.")
    robot: AnyRobot
    simulator: SimulatorName = "pybullet"
    seed: Seed


class Script:
    """Scripted demonstrator, in the place of a robot's stack. It knows the true pose."""

    def __init__(self, simulator: Simulator):
        self._simulator = simulator
        self._ranges = np.empty(0, np.float32)  # latest scan (beams,) [m]

    @property
    def goal_tolerance(self) -> float:
        """Tolerance of 0 m, because only the course's finish counts."""
        return 0.0

    def reset(self, now: float, seed: Union[int, Sequence[int]]) -> None:
        """Plan the route through the simulator's world."""
        self._demonstrator = Demonstrator(self._simulator.world, self._simulator.robot)

    def set_goal(self, goal: Pose, now: float) -> None:
        """Do nothing, because the route leads to the goal of the course."""

    def step(
        self,
        now: float,
        pose: Pose,
        twist: Twist,
        scan: Optional[LaserScan] = None,
        local_origin: Optional[Pose] = None,
    ) -> Step:
        """Return the demonstrator's command for one control cycle."""
        # The laser may be slower than the control cycle; the demonstrator then uses its last scan.
        if scan is not None:
            self._ranges = scan.ranges
        command = self._demonstrator.command(self._simulator.state.pose, self._ranges)
        return Step(Cycle(), verdict=None, command=command)


def demonstrate(options: DemonstrateOptions) -> None:
    """Drive one course and write the bag, with scans at the laser's rate.

    An unfinished drive leaves no bag.

    Raises:
        ApplrError: The course takes too long (RULES), the robot flips, or the bag exists or cannot
            be written.
    """
    robot = options.robot
    world = world_of(options.world, robot)
    simulator = sim_bridge.make(options.simulator, robot=robot)
    # The writer comes first: it refuses an existing bag before minutes of driving.
    with BagWriter(options.bag, robot, TopicNames.of(robot)) as writer:
        drive = demonstrated(world, simulator, options.seed)
        drive.source = {
            "simulator": options.simulator,
            "robot": robot.name,
            "demonstrator": NAME,
            "world": world.name,
            "seed": options.seed,
        }
        writer.write(drive)
    seconds = simulator.state.time
    print(f"{options.bag}: {world.name} demonstrated by a script in {seconds:.1f} s")


def demonstrated(world: World, simulator: Simulator, seed: int) -> Drive:
    """Drive the course of a world with the scripted demonstrator, and return the drive.

    Raises:
        ApplrError: The course takes too long (RULES), or the robot flips.
    """
    simulated_robot = SimulatedRobot(simulator, Script(simulator))
    driven = simulate.drive(simulated_robot, world, seed, rules=RULES, record=True)
    goal = driven.goals[-1]
    if goal.status != REACHED:
        trouble = f"flipped or too slow after {goal.end:.0f} s"
        raise ApplrError(f"{world.name}: {trouble}: give another --world")
    return Drive(
        name=driven.name,
        odometry=driven.odometry,
        scans=driven.scans,
        commands=driven.commands,
        sent=driven.sent,
    )


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command.

    Return 0, or 1 after a one-line error if no bag was written.
    """
    return run_command(DemonstrateOptions, demonstrate, "demonstrate.py", __doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
