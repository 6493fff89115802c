"""Records a scripted demonstration for APPLD, in simulation and without ROS: `python -m training.demonstrate BAG`.

The demonstrator is training/baselines/appld/scripted_driver.py. The bag's metadata name it.
"""

from __future__ import annotations

import sys
from typing import Optional, Sequence

import sim_bridge
import worlds
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.robots.geometry import radius
from training.common.command_line import AnyRobot, Seed, SimulatorName, parsed
from training.common.options import Options, argument, option
from training.env.episode import CONTROL_PERIOD

with extra(__name__):
    from training.bags.bag import TopicNames
    from training.bags.writer import BagWriter
    from training.baselines.appld.scripted_driver import NAME, Demonstrator

LIMIT = 200.0  # simulated time after which the demonstrator gives up [s]


class DemonstrateOptions(Options):
    """Demonstration to record."""

    bag: str = argument("Bag to write (.bag); it must not exist.")
    world: str = option("physical_course", "World to drive in.")
    robot: AnyRobot
    simulator: SimulatorName = "pybullet"
    seed: Seed


def demonstrate(options: DemonstrateOptions) -> None:
    """Drive one course and write the bag, with scans at the laser's rate. An unfinished drive leaves no bag.

    Raises:
        ApplrError: The course takes longer than LIMIT, the robot flips, or the bag cannot be written.
    """
    robot, simulator = options.robot, sim_bridge.make(options.simulator, robot=options.robot)
    world = worlds.scaled(worlds.load(options.world, radius(robot)), robot.world_scale)
    state, scan_due = simulator.reset(world, options.seed), 0.0
    driver, source = Demonstrator(world, robot), {"simulator": options.simulator, "robot": robot.name}
    with BagWriter(options.bag, TopicNames.of(robot), robot) as writer:
        writer.demonstrator(1.0, **source, demonstrator=NAME, world=world.name, seed=options.seed)
        writer.goal(1.0, simulator.to_odom(world.course.goal))
        while not world.course.arrived(*state.pose[:2]):
            if state.time > LIMIT or state.flipped:
                raise ApplrError(f"{world.name}: flipped or too slow after {state.time:.0f} s: give another --world")
            now = 1.0 + state.time
            writer.odometry(now, state.odom_pose, state.odom_twist)
            if state.time + 1e-6 >= scan_due:
                ranges, scan_due = simulator.scan(), scan_due + robot.laser.period_in(CONTROL_PERIOD)
                writer.scan(now, ranges)
            v, w = driver.command(state.pose, ranges)
            writer.command(now, v, w)
            simulator.command(v, w)
            state = simulator.advance(CONTROL_PERIOD)
    print(f"{options.bag}: {world.name} demonstrated by a script in {state.time:.1f} s")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0, or 1 after a one-line error if no bag was written."""
    name = "demonstrate.py"
    return run_main(lambda: demonstrate(parsed(DemonstrateOptions, name, __doc__, arguments)), name)


if __name__ == "__main__":
    sys.exit(main())
