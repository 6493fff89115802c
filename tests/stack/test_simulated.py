"""Tests of the simulated robot: the laser's clock, and the frame of plan and goal."""

from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.stack.simulated import CONTROL_PERIOD, SimulatedRobot
from tests.support.robots import Script


def driven(robot, cycles, seed=0):
    """Return a simulated robot with its script after some cycles, and their ticks."""
    script = Script()
    simulated = SimulatedRobot(sim_bridge.make("kinematic", robot=robot), script)
    simulated.reset(worlds.scaled(worlds.load("generated:3"), robot.world_scale), seed)
    ticks = [simulated.cycle() for _ in range(cycles)]
    return simulated, script, ticks


@pytest.mark.parametrize(("name", "every"), [("jackal", 1), ("turtlebot3_burger", 4)])
def test_a_laser_scans_at_its_own_rate_and_at_most_once_per_cycle(name, every):
    simulated, script, ticks = driven(robots.load(name), 41)
    for number, (tick, (_, _, scan, _)) in enumerate(zip(ticks, script.steps)):
        assert (scan is not None) == (number % every == 0), number
        assert tick.scan is scan
    # A slow laser is not asked for a scan that it would not have taken.
    last_scan = ticks[40].scan
    assert simulated.ranges is last_scan.ranges
    assert (simulated.look() is last_scan.ranges) == (every > 1)


def test_a_cycle_begins_with_the_state_in_which_the_cycle_before_ended():
    _, script, ticks = driven(robots.JACKAL, 5)
    for tick, next_tick in zip(ticks, ticks[1:]):
        assert next_tick.before is tick.after
        assert tick.after.time - tick.before.time == pytest.approx(CONTROL_PERIOD)
    assert [now for now, *_ in script.steps] == [tick.before.time for tick in ticks]
    assert ticks[-1].after.twist[0] > 0.0


def test_the_seed_of_a_drivers_draws_differs_from_world_to_world():
    script = Script()
    simulated = SimulatedRobot(sim_bridge.make("kinematic"), script)
    for number in (3, 4):
        simulated.reset(worlds.load(f"generated:{number}"), 7)
    (_, first_seed), (_, second_seed) = script.resets
    assert first_seed[0] == second_seed[0] == 7
    assert first_seed != second_seed


def test_without_a_map_the_goal_is_sent_in_the_frame_of_the_odometry():
    simulated, script, _ = driven(robots.JACKAL, 3)
    assert simulated.frame == robots.JACKAL.frames.odom
    simulated.send_goal()
    ((goal, now),) = script.goals
    course = simulated.simulator.world.course
    start_x, start_y, _ = course.start
    goal_x, goal_y, goal_yaw = course.goal
    assert goal == simulated.goal == pytest.approx((goal_x - start_x, goal_y - start_y, goal_yaw))
    assert now == simulated.state.time
    assert simulated.place == simulated.state.odom_pose
    # A world's map is of no use to a driver that does not plan with it.
    world = worlds.load("generated:3")
    grid = worlds.world.Grid(np.zeros((4, 4), np.int8), 1.0, (1.0, 2.0, 0.5))
    simulated.reset(replace(world, map=grid), 0)
    assert simulated.place == simulated.state.odom_pose
