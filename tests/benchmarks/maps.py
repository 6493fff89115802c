"""The planner's maps on courses like BARN's: the inflation of the local map and navfn on the global one. Called by
run.py.

Times are processor time. FORMAT.md of the golden set has the C++ figures: inflation of 200 x 200 cells 179 us, navfn
on 800 x 800 cells 1,076 us.
"""

import math
from time import process_time

import numpy as np

import worlds
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.costmap.scan import LaserScan, project
from applr_ros1.planner.navfn.navfn import Navfn
from applr_ros1.robots import load
from sim_bridge.lidar import Lidar

COURSES = (3, 60, 140, 250)  # of the built-in worlds, from sparse to dense
SPEED = 0.5  # [m/s] along the reference path
PERIOD = 0.05
REPEATS = 3  # of each drive; the least time of an update counts
ROBOT = load("jackal")
LASER = ROBOT.laser
JACKAL = footprint.pad(footprint.parse(ROBOT.parameters()["local_costmap"]["footprint"]), 0.1)


def inflation():
    """One update of the inflation layer of the local map, 200 x 200 cells, r = .30, while driving."""
    times = []
    for clouds, _ in map(_drive, COURSES):
        runs = []
        for _ in range(REPEATS):
            local, _ = _maps()
            local.inflation.update = _timed(local.inflation.update)
            for pose, scan in clouds:
                local.update(pose, project(scan))
            runs.append(local.inflation.update.took)
        times.append(np.min(runs, axis=0))
    return 1e6 * np.mean(np.concatenate(times)), "us (mean over the updates of four drives)"


def navfn():
    """One plan on the global map, 800 x 800 cells, from the driving robot to the goal, the map changing meanwhile."""
    times = []
    for clouds, goal in map(_drive, COURSES):
        runs = []
        for _ in range(REPEATS):
            _, world = _maps()
            plan = _timed(Navfn().plan)
            for pose, scan in clouds:
                world.update(pose, project(scan))
                plan(world, pose[:2], goal)
            runs.append(plan.took)
        times.append(np.min(runs, axis=0))
    every = np.concatenate(times)
    return 1e6 * np.mean(every), "us (mean over %d positions; median %.0f us)" % (len(every), 1e6 * np.median(every))


def _maps():
    """The Jackal's local and global costmap."""
    inflated = InflationParameters(0.3)
    return (
        Costmap(10, 10, 0.05, rolling=True, footprint=JACKAL, inflation=inflated),
        Costmap(40, 40, 0.05, (-20, -20), footprint=JACKAL, inflation=inflated),
    )


def _timed(function):
    """The function, with the processor time of each call appended to its `took`."""

    def call(*arguments):
        began = process_time()
        result = function(*arguments)
        call.took.append(process_time() - began)
        return result

    call.took = []
    return call


def _drive(number):
    """[(pose, LaserScan)] in the frame of the start, along a built-in world's reference path; and the goal there."""
    world = worlds.load("generated:%d" % number)
    course, lidar, noise = world.course, Lidar(LASER, world.cylinders, world.boxes), np.random.default_rng(number)
    start = np.array(course.start[:2])
    path = np.vstack((start, course.path))
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))

    def at(distance):
        near = distance + np.linspace(-0.25, 0.25, 11)  # smoothed: the path follows a grid
        return np.array([np.interp(near, along, path[:, axis]).mean() for axis in (0, 1)])

    clouds = []
    for distance in np.arange(0.0, along[-1], SPEED * PERIOD):
        x, y = at(distance)
        ahead = at(distance + 0.1)
        yaw = math.atan2(ahead[1] - y, ahead[0] - x)
        sensor = (x + LASER.pose[0] * math.cos(yaw), y + LASER.pose[0] * math.sin(yaw))
        ranges = lidar.scan(*sensor, yaw) + noise.normal(0, LASER.noise, LASER.beams)
        scan = LaserScan(
            0.0,
            LASER.first_angle,
            LASER.increment,
            LASER.range_min,
            LASER.range_max,
            ranges.astype(np.float32),
            (sensor[0] - start[0], sensor[1] - start[1], yaw),
        )
        clouds.append(((x - start[0], y - start[1], yaw), scan))
    return clouds, (course.goal[0] - start[0], course.goal[1] - start[1], course.goal[2])
