"""Records a scripted demonstration for APPLD, in simulation and without ROS.

Run it as `rosrun applr_ros1 demonstrate.py BAG` or `python -m training.appld.demonstrate BAG`.
The demonstrator is training/appld/scripted_driver.py. The bag's metadata name it.
"""

from __future__ import annotations

import sys
from typing import Optional, Sequence

import sim_bridge
import worlds
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Drive, SentGoal
from applr_ros1.drives.recorder import Recorder
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import radius
from sim_bridge.simulator import Simulator
from training.common.command_line import AnyRobot, Seed, SimulatorName, parsed
from training.common.options import Options, argument, option
from training.env.episode import CONTROL_PERIOD
from worlds import World

with extra(__name__):
    from training.appld.scripted_driver import NAME, Demonstrator
    from training.bags.write import BagWriter

LIMIT_S = 200.0  # simulated time after which the demonstrator gives up [s]


class DemonstrateOptions(Options):
    """Demonstration to record."""

    bag: str = argument("Bag to write (.bag); it must not exist.")
    world: str = option("physical_course", "World to drive in.")
    robot: AnyRobot
    simulator: SimulatorName = "pybullet"
    seed: Seed


def demonstrate(options: DemonstrateOptions) -> None:
    """Drive one course and write the bag, with scans at the laser's rate.

    An unfinished drive leaves no bag.

    Raises:
        ApplrError: The course takes longer than LIMIT_S, the robot flips, or the bag exists or
            cannot be written.
    """
    robot = options.robot
    world = worlds.scaled(worlds.load(options.world, radius(robot)), robot.world_scale)
    simulator = sim_bridge.make(options.simulator, robot=robot)
    # The writer comes first: it refuses an existing bag before minutes of driving.
    with BagWriter(options.bag, robot, TopicNames.of(robot)) as writer:
        drive = demonstrated(world, robot, simulator, options.seed)
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


def demonstrated(world: World, robot: Robot, simulator: Simulator, seed: int) -> Drive:
    """Drive the course of a world with the scripted demonstrator, and return the drive.

    Raises:
        ApplrError: The course takes longer than LIMIT_S, or the robot flips.
    """
    recorder = Recorder(world, everything=True)
    driver = Demonstrator(world, robot)
    state = simulator.reset(world, seed)
    recorder.sent.append(SentGoal(0.0, simulator.to_odom(world.course.goal), robot.frames.odom))
    scan_due = 0.0
    while not world.course.arrived(*state.pose[:2]):
        if state.time > LIMIT_S or state.flipped:
            trouble = f"flipped or too slow after {state.time:.0f} s"
            raise ApplrError(f"{world.name}: {trouble}: give another --world")
        recorder.localised(state.time, state.odom_pose, state.odom_twist)
        # The laser may be slower than the control cycle; the driver then uses its last scan.
        if state.time + 1e-6 >= scan_due:
            scan_due += robot.laser.period_in(CONTROL_PERIOD)
            scan = simulator.laser_scan()
            recorder.scanned(state.time, scan)
        command = driver.command(state.pose, scan.ranges)
        recorder.commanded(state.time, command)
        simulator.command(*command)
        state = simulator.advance(CONTROL_PERIOD)
    return recorder.drive


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command.

    Return 0, or 1 after a one-line error if no bag was written.
    """
    program_name = "demonstrate.py"

    def run() -> None:
        demonstrate(parsed(DemonstrateOptions, program_name, __doc__, arguments))

    return run_main(run, program_name)


if __name__ == "__main__":
    sys.exit(main())
