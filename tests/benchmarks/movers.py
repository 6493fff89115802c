"""How well the tracker of moving obstacles knows the simulator's: `python -m tests.benchmarks.movers`.

A line per robot and kind of drive: errors of position and velocity, time until a mover is known, share of those in view
that are, and movers that are none. run.py takes the time of one scan from here.
"""

import argparse
import math
from time import process_time

import numpy as np

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.movers.tracker import MoverTracker
from applr_ros1.planner.costmap.scan import LaserScan
from applr_ros1.planner.move_base import MoveBase
from training.env.episode import Episode, laser_pose

VIEW = 5.0  # [m] from the laser within which a mover should be known
NEAR = 0.4  # [m] beyond a true disc within which a mover of the tracker is meant to be it
SLOW = 0.3  # [m/s]: what is slower need not be known
FASTEST = 5.0  # [m/s]: what is faster has jumped back to where its animation starts
AT_WORK = 1.5  # [rad/s]
ROBOTS = "jackal", "turtlebot3_burger", "husky"
STANDING, MOVING = "fresh:0-9", "dynamic:400-409"


class Judge:
    """Compares a tracker with the truth, scan by scan."""

    def __init__(self, robot):
        self.robot, self.tracker = robot, MoverTracker.of(robot)
        self.position, self.velocity, self.radius, self.delays, self.took, self.normal = [], [], [], [], [], []
        self.seconds = self.in_view = self.known = 0.0
        self.false, self.false_marks = set(), 0
        self.where = []

    def begin(self):
        self.tracker.reset()
        self.last, self.since, self.world_false = None, {}, set()

    def see(self, scan, truth, name):
        """truth: (n, 5) as truth() gives it; name: the world's."""
        began = process_time()
        movers = self.tracker.update(scan)
        self.took.append(process_time() - began)
        dt = scan.stamp - self.last if self.last is not None else 0.0
        self.last = scan.stamp
        self.seconds += dt
        points = _points(scan)
        free = np.ones(len(movers.id), bool)
        for i, (x, y, r, vx, vy) in enumerate(truth):
            distances = np.hypot(movers.x - x, movers.y - y)
            free &= distances > r + NEAR
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
            self.normal.append(error / movers.deviation[k] / math.sqrt(2))
            self.radius.append(movers.radius[k] - r)
        for k in np.flatnonzero(free):
            if int(movers.id[k]) not in self.world_false:
                self.where.append((name, round(scan.stamp, 2), *(round(float(c[k]), 2) for c in movers[1:])))
            self.world_false.add(int(movers.id[k]))
            self.false_marks += 1
            self.false.add((name, int(movers.id[k])))

    def line(self):
        minutes = self.seconds / 60.0
        rms = [
            math.sqrt(np.mean(np.square(values))) if values else math.nan for values in (self.position, self.velocity)
        ]
        delay = np.percentile(self.delays, [50, 90]) if self.delays else (math.nan, math.nan)
        share = self.known / self.in_view if self.in_view else math.nan
        return (
            f"position {rms[0]:.3f} m, velocity {rms[1]:.3f} m/s (median {np.median(self.velocity or [math.nan]):.3f}; "
            f"{math.sqrt(np.mean(np.square(self.normal or [math.nan]))):.2f} sigma), radius "
            f"{np.mean(self.radius or [math.nan]):+.3f} m, delay {delay[0]:.2f} s (90 %: {delay[1]:.2f}), known "
            f"{share:.2f}, false {len(self.false) / minutes:.2f} a minute "
            f"({self.false_marks} marks in {minutes:.1f} min), {1e3 * np.mean(self.took):.3f} ms"
        )


def truth(simulator, scan):
    """(n, 5) x, y, radius, vx, vy of the world's movers in the odometry's frame; while one pushes the robot, none."""
    if simulator.state.contact:
        return np.empty((0, 5))
    c_from = laser_pose(simulator.state.pose, simulator.robot.laser)
    to_odom = compose(scan.sensor_pose, inverse(c_from))
    now, dt = simulator.state.time, 0.01
    here, after = simulator.mover_circles(now), simulator.mover_circles(now + dt)
    c, s = math.cos(to_odom[2]), math.sin(to_odom[2])
    rows = np.empty((len(here), 5))
    rows[:, 0], rows[:, 1] = transform_point(to_odom, here[:, 0], here[:, 1])
    vx, vy = ((after - here)[:, :2] / dt).T
    rows[:, 2], rows[:, 3], rows[:, 4] = here[:, 2], c * vx - s * vy, s * vx + c * vy
    return rows


def _points(scan):
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    hit = np.isfinite(scan.ranges) & (scan.ranges >= scan.range_min) & (scan.ranges < scan.range_max)
    r, a = scan.ranges[hit], angles[hit]
    return np.column_stack(transform_point(scan.sensor_pose, r * np.cos(a), r * np.sin(a)))


def _worlds(robot, spec):
    return [worlds.scaled(world, robot.world_scale) for world in worlds.load_all(spec)]


def turning(robot, spec, seconds=20.0, simulator="kinematic", rate=AT_WORK):
    """The robot turns about on the spot, this way and that."""
    judge, simulator = Judge(robot), sim_bridge.make(simulator, robot=robot)
    period = max(1.0 / robot.laser.rate, 0.02)
    laser = robot.laser
    for number, world in enumerate(_worlds(robot, spec)):
        simulator.reset(world, number)
        judge.begin()
        while simulator.state.time < seconds:
            way = 1.0 if simulator.state.time % 5.0 < 3.0 else -1.0
            simulator.command(0.0, way * rate)
            state = simulator.advance(period)
            ranges = simulator.scan()
            pose = laser_pose(state.odom_pose, laser)
            limits = laser.first_angle, laser.increment, laser.range_min, laser.range_max
            scan = LaserScan(state.time, *limits, ranges, pose)
            judge.see(scan, truth(simulator, scan), world.name)
    return judge


def driving(robot, spec, seconds=30.0, simulator="kinematic"):
    """The planner drives with the robot's own parameters."""
    judge, simulator = Judge(robot), sim_bridge.make(simulator, robot=robot)
    move_base = MoveBase(robot.parameters())
    episode = Episode(simulator, move_base, robot, period=1.0, monitor=True)
    step = move_base.step

    def watched(now, pose, twist, scan):
        if scan is not None:
            judge.see(scan, truth(simulator, scan), simulator.world.name)
        return step(now, pose, twist, scan)

    move_base.step = watched
    for number, world in enumerate(_worlds(robot, spec)):
        judge.begin()
        episode.reset(world, number)
        for _ in range(int(seconds)):
            if episode.decide(episode.space.theta0).over:
                break
    return judge


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--standing", default=STANDING)
    parser.add_argument("--moving", default=MOVING)
    parser.add_argument("--simulator", default="kinematic")
    parser.add_argument("--kinds", nargs="+", default=["turning", "driving"])
    parser.add_argument("--where", action="store_true")
    options = parser.parse_args()
    for name in options.robots:
        robot = robots.load(name)
        for spec in (options.standing, options.moving):
            for kind in options.kinds:
                judge = globals()[kind](robot, spec, simulator=options.simulator)
                print(f"{name}, {kind}, {spec}: {judge.line()}", flush=True)
                if options.where:
                    for row in judge.where[:40]:
                        print("   ", *row)


if __name__ == "__main__":
    main()
