"""How well the tracker of moving obstacles knows the simulator's: `python -m tests.benchmarks.movers`.

A line per robot, worlds and kind of drive. run.py takes four figures of the Jackal from here. Worlds are for training:
choices may be made by them.
"""

import argparse
import functools
import math
from time import process_time

import numpy as np

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.movers.warm_up import warm_up
from applr_ros1.planner.costmap.scan import LaserScan
from applr_ros1.planner.move_base import MoveBase
from training.env.episode import Episode, laser_pose

VIEW = 5.0  # [m] from the laser within which a mover that at least three beams hit should be known
NEAR = 0.4  # [m] beyond a true disc within which a mover of the tracker is meant to be it
SLOW, FASTEST = 0.3, 5.0  # [m/s]: what is slower need not be known, what is faster has jumped back to its start
TURN = 1.5  # [rad/s]
ROBOTS = "jackal", "turtlebot3_burger", "husky"
STANDING, MOVING = "fresh:20-24", "dynamic:400-404"


class Judge:
    """Compares a tracker with the truth, scan by scan.

    Attributes:
        position, velocity: errors [m, m/s] of the movers in view that are known.
        normal: errors of the velocity as multiples of what the tracker expects.
        delays: from when a mover is in view until it is known [s].
        took: processor time of each update [s].
        in_view, known, seconds: time [s] summed over movers in view, those of them that are known; time in all.
        false: {(drive, id)} of movers that were none.
        marks, wrong: movers told in all scans; those of them where none is.
    """

    def __init__(self, robot):
        self.robot, self.tracker = robot, MoverTracker.of(robot)
        self.position, self.velocity, self.normal, self.delays, self.took = [], [], [], [], []
        self.in_view = self.known = self.seconds = 0.0
        self.false, self.marks, self.wrong, self.drives = set(), 0, 0, 0

    def begin(self):
        """A drive begins."""
        self.tracker.reset()
        self.drives += 1
        self.last, self.since = None, {}

    def see(self, scan, truth):
        """A scan (LaserScan), and (n, 5) x, y, radius, vx, vy of the movers in its frame; None: nothing is judged."""
        began = process_time()
        movers = self.tracker.update(scan)
        self.took.append(process_time() - began)
        dt = scan.stamp - self.last if self.last is not None else 0.0
        self.last = scan.stamp
        self.seconds += dt
        if truth is None:
            return
        points, wrong = hits(scan), np.ones(len(movers.id), bool)
        for i, (x, y, r, vx, vy) in enumerate(truth.tolist()):
            distances = np.hypot(movers.x - x, movers.y - y)
            wrong &= distances > r + NEAR
            on = np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - r) < 0.04
            away = math.hypot(x - scan.sensor_pose[0], y - scan.sensor_pose[1])
            if on.sum() < 3 or away > VIEW or not SLOW < math.hypot(vx, vy) < FASTEST:
                self.since.pop(i, None)
                continue
            since = self.since.setdefault(i, [scan.stamp, False])
            self.in_view += dt
            if not len(distances) or distances.min() > r + NEAR:
                continue
            self.known += dt
            k = int(distances.argmin())
            if not since[1]:
                since[1] = True
                self.delays.append(scan.stamp - since[0])
            error = math.hypot(movers.vx[k] - vx, movers.vy[k] - vy)
            self.position.append(distances[k])
            self.velocity.append(error)
            self.normal.append(error / movers.deviation[k] / math.sqrt(2.0))
        self.marks += len(wrong)
        self.wrong += int(wrong.sum())
        self.false |= {(self.drives, int(number)) for number in movers.id[wrong]}

    def line(self):
        """What came out."""
        minutes = self.seconds / 60.0
        took = f"{1e3 * np.median(self.took):.3f} ms"
        if not self.in_view:
            return f"{len(self.false)} false movers in {minutes:.1f} min, {took}"
        rms, median = math.sqrt(np.mean(np.square(self.velocity))), np.median(self.velocity)
        return (
            f"position {np.median(self.position):.2f} m, velocity {median:.2f} m/s (rms {rms:.2f}, "
            f"{np.median(self.normal) / 0.83:.1f} deviations), delay {np.mean(self.delays):.2f} s, known "
            f"{self.known / self.in_view:.2f}, {self.wrong / self.marks:.2f} of the marks elsewhere, "
            f"{minutes:.1f} min, {took}"
        )


def truth(simulator, scan):
    """(n, 5) as Judge.see takes it; None while the robot touches one, since its odometry is wrong then."""
    if not simulator.world.movers:
        return np.empty((0, 5))
    if simulator.state.contact:
        return None
    to_odom = compose(scan.sensor_pose, inverse(laser_pose(simulator.state.pose, simulator.robot.laser)))
    now, dt = simulator.state.time, 0.01
    here, after = simulator.mover_circles(now), simulator.mover_circles(now + dt)
    places = transform_point(to_odom, *here[:, :2].T)
    velocities = transform_point((0.0, 0.0, to_odom[2]), *((after - here)[:, :2] / dt).T)
    return np.column_stack([*places, here[:, 2], *velocities])


def hits(scan):
    """(n, 2) the points of a scan [m], in its frame."""
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    hit = (scan.ranges >= scan.range_min) & (scan.ranges < scan.range_max)
    r, a = scan.ranges[hit], angles[hit]
    return np.column_stack(transform_point(scan.sensor_pose, r * np.cos(a), r * np.sin(a)))


def turning(judge, simulator, world, seed, seconds):
    """The robot turns about on the spot, this way and that."""
    laser, period = judge.robot.laser, max(1.0 / judge.robot.laser.rate, 0.02)
    simulator.reset(world, seed)
    judge.begin()
    while simulator.state.time < seconds:
        simulator.command(0.0, TURN if simulator.state.time % 5.0 < 3.0 else -TURN)
        state = simulator.advance(period)
        limits = laser.first_angle, laser.increment, laser.range_min, laser.range_max
        scan = LaserScan(state.time, *limits, simulator.scan(), laser_pose(state.odom_pose, laser))
        judge.see(scan, truth(simulator, scan))


def driving(judge, simulator, world, seed, seconds):
    """The planner drives with the robot's own parameters, past the movers or into them."""
    move_base = MoveBase(judge.robot.parameters())
    episode, step = Episode(simulator, move_base, judge.robot, period=1.0, monitor=True), move_base.step

    def watched(now, pose, twist, scan):
        if scan is not None:
            judge.see(scan, truth(simulator, scan))
        return step(now, pose, twist, scan)

    move_base.step = watched
    judge.begin()
    episode.reset(world, seed)
    while episode.simulator.state.time < seconds and not episode.decide(episode.space.theta0).over:
        pass


@functools.lru_cache(maxsize=None)
def measured(name, kind, spec, simulator="kinematic", seconds=20.0):
    """The Judge of a robot's drives through the worlds of a specification."""
    warm_up()
    robot = robots.load(name)
    judge, simulator = Judge(robot), sim_bridge.make(simulator, robot=robot)
    for number, world in enumerate(worlds.load_all(spec)):
        kind(judge, simulator, worlds.scaled(world, robot.world_scale), number, seconds)
    simulator.close()
    return judge


def tracker_update():
    return 1e3 * np.mean(measured("jackal", turning, STANDING).took), "ms a scan (mean; 720 beams)"


def tracker_velocity():
    return np.median(measured("jackal", driving, MOVING).velocity), "m/s (median error)"


def tracker_delay():
    return np.mean(measured("jackal", driving, MOVING).delays), "s until a mover is known (mean)"


def tracker_false():
    judges = [measured("jackal", kind, STANDING) for kind in (turning, driving)]
    return 60.0 * sum(len(j.false) for j in judges) / sum(j.seconds for j in judges), "movers a minute that are none"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--worlds", nargs="+", default=[STANDING, MOVING])
    parser.add_argument("--simulator", default="kinematic", choices=sim_bridge.NAMES)
    options = parser.parse_args()
    for name in options.robots:
        for spec in options.worlds:
            for kind in (turning, driving):
                judge = measured(name, kind, spec, options.simulator)
                print(f"{name}, {kind.__name__}, {spec}: {judge.line()}", flush=True)


if __name__ == "__main__":
    main()
