"""Records a scripted demonstration for APPLD, in simulation and without ROS.

Started as `rosrun applr_ros1 demonstrate.py` or `python -m training.demonstrate`. The demonstrator is the script
training/baselines/appld/scripted_driver.py, and the bag says so. A person demonstrates with teleop.py instead.
"""

from __future__ import annotations

import sys

import sim_bridge
import worlds
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from training.common.command_line import AnyRobot, Seed, SimulatorName, parsed
from training.common.options import Options, argument, option
from training.env.episode import CONTROL_PERIOD

with extra(__name__):
    from training.bags.reader import TopicNames
    from training.bags.writer import BagWriter
    from training.baselines.appld.scripted_driver import NAME, Demonstrator


def demonstrate(world, simulator, bag, seed: int = 0, limit: float = 200.0, said=None) -> dict:
    """Drive one course with the simulator's robot and write the bag, its scans at the laser's rate.

    Args:
        world: The world, at the robot's scale.
        simulator: That drives.
        bag: Path of the bag; it must not exist.
        seed: Of the simulator's noise.
        limit: Simulated time [s] after which the demonstrator gives up.
        said: What the bag says of the demonstration beside demonstrator, world and seed.

    Returns:
        a dict with seconds, metres, speed [m/s] and contacts.

    Raises:
        ApplrError: the course was not finished within `limit` seconds.
        StorageError: the bag cannot be written.
    """
    robot = simulator.robot
    driver = Demonstrator(world, robot)
    state = simulator.reset(world, seed)
    metres, contacts, began = 0.0, 0, state.time
    scan_period, scan_due = robot.laser.period_in(CONTROL_PERIOD), began
    with BagWriter(bag, TopicNames.of(robot), robot) as writer:
        source = dict(said or {}, demonstrator=NAME, world=world.name, seed=seed)
        writer.demonstrator(1.0, **source)
        writer.goal(1.0, simulator.to_odom(world.course.goal))
        try:
            while not world.course.done(*state.pose[:2]):
                now = 1.0 + state.time
                if state.time - began > limit or state.flipped:
                    raise ApplrError(
                        f"{world.name}: not through after {state.time - began:.0f} s; the demonstration is not usable"
                    )
                scans = state.time + 1e-6 >= scan_due
                if scans:
                    ranges, scan_due = simulator.scan(), scan_due + scan_period
                v, w = driver.command(state.pose, ranges)
                writer.odometry(now, state.odom_pose, state.odom_twist)
                if scans:
                    writer.scan(now, ranges)
                writer.command(now, v, w)
                simulator.command(v, w)
                state = simulator.advance(CONTROL_PERIOD)
                metres += abs(state.twist[0]) * CONTROL_PERIOD
                contacts += bool(state.contact)
                if state.contact:
                    writer.contact(1.0 + state.time)
        except (KeyboardInterrupt, ApplrError) as stopped:
            writer.demonstrator(1.0 + state.time, **source, partial=True)
            why = str(stopped) or f"stopped after {state.time - began:.0f} s"
            raise type(stopped)(f"{why}; {bag} holds a part of a demonstration, and says so") from None
    seconds = state.time - began
    return {
        "seconds": round(seconds, 2),
        "metres": round(metres, 2),
        "speed": round(metres / seconds, 3),
        "contacts": contacts,
    }


class DemonstrateOptions(Options):
    """What to record."""

    bag: str = argument("Bag to write (.bag); it must not exist.")
    world: str = option("physical_course", "World to drive in.")
    robot: AnyRobot
    simulator: SimulatorName = "pybullet"
    seed: Seed


def main(arguments=None) -> int:
    """Exit status 0; 1 with one line when there is no usable demonstration."""
    name = "demonstrate.py"
    return run_main(lambda: run(parsed(DemonstrateOptions, name, __doc__, arguments)), name)


def run(options: DemonstrateOptions) -> None:
    """Drives and records as the options say."""
    world = worlds.scaled(worlds.load(options.world), options.robot.world_scale)
    simulator = sim_bridge.make(options.simulator, robot=options.robot)
    said = {"simulator": options.simulator, "robot": options.robot.name}
    found = demonstrate(world, simulator, options.bag, options.seed, said=said)
    print(
        f"{options.bag}: {world.name} demonstrated by a script in {found['seconds']:.1f} s, {found['metres']:.1f} m at "
        f"{found['speed']:.2f} m/s, {found['contacts']} contacts"
    )


if __name__ == "__main__":
    sys.exit(main())
