"""Tests of a simulated robot that drives in the frame of the monitor's matched poses."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.common.angles import compose
from applr_ros1.drives import simulate
from applr_ros1.drives.end_rules import Rules
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.planner.state_machine import Cycle
from applr_ros1.robots.robot import MoveBaseSetup
from training.env.settings import TrialSettings

CORRECTION = (0.5, -0.2, 0.3)  # pose of the odometry frame in that of the matched poses
WORLD = "generated:3"


def made(robot="jackal", **settings):
    """Return a simulated robot with a monitor, reset in a world."""
    settings = TrialSettings(robot=robot, monitor=True, **settings)
    simulator = sim_bridge.make("kinematic", robot=settings.robot, odometry=(3.0, 3.0))
    simulated = settings.simulated(simulator, settings.robot)
    simulated.reset(worlds.scaled(worlds.load(WORLD), settings.robot.world_scale), 0)
    return simulated


def corrected(monkeypatch, simulated):
    """Let each scan correct the odometry by CORRECTION, and return the planner's inputs."""
    monitor = simulated.stack.monitor
    inputs = []

    def add_scan(scan, topic=""):
        monitor.matcher.correction = CORRECTION
        return ""

    def step(now, pose, twist, sensed, local_origin):
        inputs.append((pose, sensed, local_origin))
        return Cycle()

    monkeypatch.setattr(monitor, "add_scan", add_scan)
    monkeypatch.setattr(simulated.stack.move_base, "step", step)
    return inputs


def test_the_correction_by_a_scan_moves_pose_and_scan_in_the_next_cycle(monkeypatch):
    simulated = made()
    inputs = corrected(monkeypatch, simulated)
    ticks = [simulated.cycle(), simulated.cycle()]
    for tick, (pose, scan, local_origin), correction in zip(
        ticks, inputs, [(0.0, 0.0, 0.0), CORRECTION]
    ):
        assert pose == tick.planner_pose == compose(correction, tick.before.odom_pose)
        assert scan.sensor_pose == pytest.approx(compose(correction, tick.scan.sensor_pose))
        assert local_origin is None, "both costmaps are in one frame"
        assert tick.place == compose(CORRECTION, tick.after.odom_pose)
    assert simulated.place == tick.place
    assert simulated.frame == "matched"


def test_predicted_obstacle_points_are_moved_as_well(monkeypatch):
    simulated = made(movers=True)
    inputs = corrected(monkeypatch, simulated)
    simulated.stack.monitor.matcher.correction = CORRECTION
    tick = simulated.cycle()
    ((_, sensed, _),) = inputs
    cloud = sensed[PREDICTED]
    laser_x, laser_y, _ = compose(CORRECTION, tick.scan.sensor_pose)
    assert sensed["front/scan"].sensor_pose[:2] == pytest.approx((laser_x, laser_y))
    original = simulated.stack.prediction.add_scan(tick.scan)
    moved_x, moved_y, _ = compose(CORRECTION, (*original.position[:2], 0.0))
    assert cloud.position[:2] == pytest.approx((moved_x, moved_y))


def test_the_goal_stays_in_the_matched_frame(monkeypatch):
    simulated = made()
    corrected(monkeypatch, simulated)
    simulated.cycle()
    simulated.send_goal()
    sent_goal = simulated.simulator.to_odom(simulated.simulator.world.course.sent_goal)
    goal = compose(CORRECTION, sent_goal)
    assert simulated.goal == goal
    simulated.stack.monitor.matcher.correction = (0.0, 0.0, 0.0)
    assert simulated.goal == simulated.stack.move_base.goal == goal


def test_methods_see_moving_obstacles_in_the_frame_of_plan_and_goal(monkeypatch):
    simulated = made(movers=True)
    simulated.stack.monitor.matcher.correction = CORRECTION
    tracked = np.array([[1.0, 2.0, 0.5, 0.0]])
    monkeypatch.setattr(type(simulated.stack), "movers", tracked)
    ((x, y, vx, vy),) = simulated.movers
    assert (x, y) == pytest.approx(compose(CORRECTION, (1.0, 2.0, 0.0))[:2])
    assert (vx, vy) == pytest.approx((0.5 * math.cos(0.3), 0.5 * math.sin(0.3)))


def test_a_recorded_plan_is_in_the_frame_of_the_recorded_poses(monkeypatch):
    simulated = made()
    world = simulated.simulator.world
    add_scan = simulated.stack.monitor.add_scan

    def add_and_correct(scan, topic=""):
        fault = add_scan(scan, topic)
        simulated.stack.monitor.matcher.correction = CORRECTION
        return fault

    monkeypatch.setattr(simulated.stack.monitor, "add_scan", add_and_correct)
    drive = simulate.drive(simulated, world, 0, rules=Rules(limit=2.0), record=True)
    assert len(drive.routes) > 0
    assert drive.frame == "matched"
    for time, route in zip(drive.routes.time, drive.routes.path):
        odometry_row = drive.odometry.latest(time)
        offset = route[0, :2] - drive.odometry.pose[odometry_row, :2]
        assert np.hypot(*offset) < 0.1, "a plan begins at the robot"


@pytest.mark.parametrize("settings", [{"monitor": False}, {"matched": False}])
def test_without_monitor_or_matched_poses_the_planner_is_in_the_odometry_frame(settings):
    settings = TrialSettings(**{"monitor": True, **settings})
    simulator = sim_bridge.make("kinematic", robot=settings.robot)
    simulated = settings.simulated(simulator, settings.robot)
    simulated.reset(worlds.load(WORLD), 0)
    assert simulated.correction is None
    assert simulated.frame == "odom"
    assert simulated.place == simulated.state.odom_pose


def test_a_map_has_its_own_frame():
    waffle = robots.load("turtlebot3_waffle_pi").in_matched_frame()
    for costmap in ("global_costmap", "local_costmap"):
        assert waffle.parameters()[costmap]["global_frame"] == "matched"
    assert waffle.on_map().parameters()["global_costmap"]["global_frame"] == "map"


def test_a_map_whose_frame_is_the_default_has_its_own_frame():
    husky = robots.load("husky")
    without_map, with_map = husky.move_base
    global_costmap = dict(with_map["global_costmap"])
    del global_costmap["global_frame"]
    setup = MoveBaseSetup(without_map, {**with_map, "global_costmap": global_costmap})
    on_map = replace(husky, move_base=setup).on_map()
    assert on_map.in_matched_frame() is on_map


def test_a_robot_whose_costmaps_are_in_the_frame_of_a_slam_keeps_it():
    without_map, with_map = robots.JACKAL.move_base
    global_costmap = {**without_map["global_costmap"], "global_frame": "map"}
    setup = MoveBaseSetup({**without_map, "global_costmap": global_costmap}, with_map)
    robot = replace(robots.JACKAL, move_base=setup)
    assert robot.in_matched_frame() is robot


def test_the_place_in_the_matched_frame_is_nearer_to_the_truth_than_the_odometry():
    drift = 0.0
    error = 0.0
    for name in (WORLD, "generated:8", "generated:120"):
        simulated = made()
        simulated.reset(worlds.load(name), 0)
        simulate.drive(simulated, simulated.simulator.world, 0, rules=Rules(limit=60.0))
        truth = simulated.simulator.to_odom(simulated.state.pose)[:2]
        drift += math.dist(simulated.state.odom_pose[:2], truth)
        error += math.dist(simulated.place[:2], truth)
    assert drift > 0.1
    assert error < 0.3 * drift
