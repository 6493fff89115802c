"""Tests of passive safety: the base rests before what moves touches it.

Scenes in closed form: a base that follows each command of the monitor at once, among discs that
move as the monitor assumes, seen by the robot's laser.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.monitor import MOVER_COMES, PASS, CollisionMonitor
from applr_ros1.monitor.moving import (
    DEVIATIONS,
    DISC,
    may_meet,
    tracked_discs,
    will_meet,
    without_movers,
)
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.monitor.stopping import (
    BaseMotion,
    BodyPose,
    braking_time,
    edge_points,
    half_planes,
)
from applr_ros1.movers.tracker import Movers
from sim_bridge.lidar import Lidar
from tests.monitor.scenes import AT_REST, BODY, FRONT, HERE, SIDE, safe_scale_of
from tests.monitor.test_ways import braking_distance, smallest_passing
from tests.support.robots import scan_by

PERIOD = 0.05  # control period [s]
RADIUS = 0.25  # radius of the moving obstacles [m]
MEET_S = 2.5  # time at which an undisturbed robot would meet it [s]
STANDS = 0.1  # speed up to which a robot counts as standing [m/s]
ROBOTS = {name: robots.load(name) for name in ("jackal", "husky", "turtlebot3_waffle_pi")}
WALL = np.array([[4.0, -0.8, 0.0, 12.0, 0.2]])  # beside the robot's way
AHEAD = BodyPose(0.0, 0.0, 1.0, 0.0)


class Scene(NamedTuple):
    """Moving and standing obstacles, and the command.

    Attributes:
        paths: Function of the time [s] that returns the centre (x, y) [m], for each mover.
        boxes: (n, 5) boxes that stand.
        command: (v, w) that the planner repeats.
    """

    paths: list
    command: tuple
    boxes: np.ndarray = np.zeros((0, 5))


class Ride(NamedTuple):
    """Ride through a scene.

    Attributes:
        touch_speed: Speed of the base when it was touched first [m/s]; NaN if it never was.
        x: Final place [m].
        actions: Actions of the monitor.
        reasons: Its reasons.
    """

    touch_speed: float
    x: float
    actions: list
    reasons: list


def straight(x, y, vx, vy):
    """Return the path of a disc with constant velocity."""
    return lambda time: (x + vx * time, y + vy * time)


def ride(robot, scene, seconds=4.0, **changes):
    """Drive a base through a scene, from (0, 0, 0) on."""
    settings = replace(MonitorSettings.of(robot), **changes)
    monitor = CollisionMonitor(settings)
    planes = half_planes(settings.body)
    edge = edge_points(settings.body)
    laser = robot.laser
    scan_cycles = max(round(1.0 / (laser.rate * PERIOD)), 1)
    x = y = yaw = v = w = 0.0
    touch_speed = math.nan
    actions = []
    reasons = []
    for cycle in range(round(seconds / PERIOD)):
        time = cycle * PERIOD
        centres = np.array([path(time) for path in scene.paths])
        pose = (x, y, yaw)
        if is_touched(pose, planes, edge, centres):
            touch_speed = abs(v)
            break
        if cycle % scan_cycles == 0:
            discs = [(*centre, RADIUS) for centre in centres]
            sensor_pose = laser.pose_for(pose)
            ranges = Lidar(laser, discs, scene.boxes).scan(*sensor_pose)
            scan = scan_by(laser, time, ranges, sensor_pose)
            monitor.add_scan(scan)
        verdict = monitor.filter(time, pose, (v, w), scene.command)
        actions.append(verdict.action)
        reasons.append(verdict.reason)
        v, w = verdict.command
        x += v * PERIOD * math.cos(yaw + 0.5 * w * PERIOD)
        y += v * PERIOD * math.sin(yaw + 0.5 * w * PERIOD)
        yaw += w * PERIOD
    return Ride(touch_speed, x, actions, reasons)


def is_touched(pose, planes, edge, centres):
    """Return whether a disc touches the body at a pose."""
    x, y, yaw = pose
    for centre_x, centre_y in centres:
        forward = math.cos(yaw) * (centre_x - x) + math.sin(yaw) * (centre_y - y)
        leftward = math.cos(yaw) * (centre_y - y) - math.sin(yaw) * (centre_x - x)
        is_inside = (planes[:, :2] @ (forward, leftward) <= planes[:, 2]).all()
        if is_inside or np.hypot(*(edge - (forward, leftward)).T).min() < RADIUS:
            return True
    return False


def crossing(v, u):
    return Scene([straight(v * MEET_S, u * MEET_S, 0.0, -u)], (v, 0.0))


def head_on(v, u):
    return Scene([straight((v + u) * MEET_S, 0.1, -u, 0.0)], (v, 0.0))


def obliquely_from_behind(v, u):
    """It comes from 120 degrees to the left, which lasers of 270 degrees still see."""
    vx = v + 0.5 * u
    vy = -math.sqrt(0.75) * u
    return Scene([straight(v * MEET_S - vx * MEET_S, -vy * MEET_S, vx, vy)], (v, 0.0))


def cutting_in(v, u):
    """It drives ahead beside the robot's way, and more slowly, and turns into it."""

    def path(time):
        return 1.5 + 0.5 * v * time, max(1.0 - max(time - 0.5, 0.0) * 0.5 * u, 0.0)

    return Scene([path], (v, 0.0))


def stopping_in_front(v, u):
    """It drives ahead at the robot's speed, and brakes with 1 m/s^2."""

    def path(time):
        braking = min(max(time - 1.0, 0.0), v)
        return 0.9 + FRONT + RADIUS + v * min(time, 1.0) + v * braking - 0.5 * braking**2, 0.0

    return Scene([path], (v, 0.0))


def two_at_once(v, u):
    from_right = straight(v * MEET_S, -u * MEET_S - 0.2, 0.0, u)
    return Scene([crossing(v, u).paths[0], from_right], (v, 0.0))


def along_a_wall(v, u):
    return crossing(v, u)._replace(boxes=WALL)


def while_the_robot_turns(v, u):
    w = 0.3
    radius = v / w
    x = radius * math.sin(w * MEET_S)
    y = radius * (1.0 - math.cos(w * MEET_S))
    return Scene([straight(x + u * MEET_S, y, -u, 0.0)], (v, w))


SCENES = (
    crossing,
    head_on,
    obliquely_from_behind,
    cutting_in,
    stopping_in_front,
    two_at_once,
    along_a_wall,
    while_the_robot_turns,
)


@pytest.mark.heavy
@pytest.mark.parametrize(
    "robot_name",
    ["jackal", "turtlebot3_waffle_pi", pytest.param("husky", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("scene", SCENES)
def test_the_base_rests_before_it_is_touched(scene, robot_name):
    robot = ROBOTS[robot_name]
    fastest = robot.base.max_speed
    for v in {min(0.5, fastest), fastest}:
        for u in (0.5, 1.0, 2.0):
            result = ride(robot, scene(v, u))
            assert not result.touch_speed > STANDS, (v, u, result.touch_speed)


@pytest.mark.parametrize("robot_name", ROBOTS)
def test_what_overtakes_or_drives_away_does_not_stop_the_base(robot_name):
    robot = ROBOTS[robot_name]
    v = 0.5 * robot.base.max_speed
    overtaking = straight(-1.0, 1.6, v + 0.5, 0.0)
    leading = straight(2.0, 0.0, v + 0.5, 0.0)
    result = ride(robot, Scene([overtaking, leading], (v, 0.0), WALL))
    assert math.isnan(result.touch_speed)
    # At the start, velocities are uncertain, and points of the leading one are remembered.
    assert set(result.actions[30:]) == {PASS}


@pytest.mark.parametrize("passive_safety", [True, False])
def test_passive_safety_can_be_switched_off(passive_safety):
    robot = ROBOTS["jackal"]
    monitor = robot.monitor.model_copy(update={"passive_safety": passive_safety})
    result = ride(replace(robot, monitor=monitor), crossing(1.0, 1.0))
    assert (MOVER_COMES in result.reasons) == passive_safety
    assert (result.touch_speed > STANDS) == (not passive_safety)


def test_a_base_at_rest_lets_a_mover_pass_and_then_drives_on():
    robot = ROBOTS["jackal"]
    crosses = straight(0.9, 1.6, 0.0, -0.8)
    result = ride(robot, Scene([crosses], (0.6, 0.0)), seconds=6.0)
    assert math.isnan(result.touch_speed)
    assert result.x > 1.0
    assert MOVER_COMES in result.reasons
    assert MOVER_COMES not in result.reasons[-20:]


def test_what_stands_moves_for_nobody_while_the_wheels_slip():
    """The robot stands in a room with a post. Its odometry slides sideways at 1 m/s for 1.5 s.

    The tracker also predicts for the costmaps. What comes afterwards is seen where it is.
    """
    robot = ROBOTS["jackal"]
    laser = robot.laser
    walls = [(3.0, 0.0, 0.0, 0.2, 8.0), (0.0, 3.0, 0.0, 8.0, 0.2), (0.0, -3.0, 0.0, 8.0, 0.2)]
    lidar = Lidar(laser, [(1.5, 0.3, RADIUS)], np.array(walls))
    rng = np.random.default_rng(0)
    monitor = CollisionMonitor(MonitorSettings.of(robot))
    tracker = monitor.lasers.first.tracker
    tracked = 0
    for number in range(60):
        stamp = number * PERIOD
        comes = np.array([(4.3 - stamp, 0.0, RADIUS)])
        ranges = lidar.scan(*laser.pose_for(HERE), comes[: number >= 30])
        ranges += rng.normal(0.0, 0.003, len(ranges)).astype(np.float32)
        slid_pose = (0.0, min(stamp, 1.5), 0.0)
        monitor.add_scan(scan_by(laser, stamp, ranges, laser.pose_for(slid_pose)))
        if number < 30:
            tracked += len(tracker.movers.id)
    assert tracked == 0
    verdict = monitor.filter(stamp, slid_pose, AT_REST, (0.5, 0.0))
    assert verdict.reason == MOVER_COMES


# -- one command -----------------------------------------------------------------------------------
def disc(x, y, vx=0.0, vy=0.0, **more):
    """Return DISCs (1,) with one disc of RADIUS."""
    discs = np.zeros(1, DISC)
    values = {"x": x, "y": y, "vx": vx, "vy": vy, "radius": RADIUS, **more}
    for name, value in values.items():
        discs[name] = value
    return discs


def smallest_free(v, **more):
    """Return the smallest gap [m] ahead to a disc of these values at which v [m/s] is free."""

    def is_free(gap):
        discs = disc(FRONT + BODY.margin + RADIUS + gap, 0.0, **more)
        return safe_scale_of([], BaseMotion(v, 0.0), (v, 0.0), discs=discs) == 1.0

    return smallest_passing(0.0, 6.0, is_free)


V = 1.0
REST_S = 0.15 + braking_time(V, 4.0)  # time until the base stands [s]
WAY_M = 0.15 * V + braking_distance(V, 4.0)  # way until then [m]


@pytest.mark.parametrize(
    ("values", "gap"),
    [
        # What stands is met where the base stops.
        ({}, WAY_M),
        # What comes has moved on by then, and may have sped up.
        ({"vx": -1.5}, WAY_M + 1.5 * REST_S),
        # What drives away faster than the base is followed.
        ({"vx": 1.5}, 0.0),
        ({"vx": -1.5, "acceleration": 2.0}, WAY_M + 1.5 * REST_S + REST_S**2),
        # The scan is older than the pose.
        ({"vx": -1.5, "age": 0.2}, WAY_M + 1.5 * (REST_S + 0.2)),
        # Its place is known to 0.1 m, and its velocity to 0.4 m/s.
        ({"pp": 0.01, "vv": 0.16}, WAY_M + DEVIATIONS * math.hypot(0.1, 0.4 * REST_S)),
    ],
)
def test_the_base_rests_before_the_place_of_a_disc_at_that_time(values, gap):
    assert smallest_free(V, **values) == pytest.approx(gap, abs=0.045)


def test_a_base_that_gains_speed_late_must_be_free_too():
    """At 2 m/s it is past the crossing disc in time, at 0.5 m/s it is not."""
    crosses = disc(0.3, 1.5, vy=-1.6)
    fast = safe_scale_of([], BaseMotion(2.0, 0.0), (2.0, 0.0), discs=crosses)
    slow = safe_scale_of([], BaseMotion(0.5, 0.0), (2.0, 0.0), discs=crosses)
    assert fast == 1.0
    assert slow < 1.0


def test_a_base_does_not_come_to_rest_in_the_way_of_what_crosses_later():
    """It would stand there half a second before the disc comes."""
    in_way = disc(0.6, 1.6, vy=-1.0)
    stands = BaseMotion(0.0, 0.0)
    assert safe_scale_of([], stands, (0.7, 0.0), discs=in_way) < 1.0
    # In the way already, it drives on: to stay would not help.
    met_anyway = disc(0.0, 1.4, vy=-1.0)
    assert safe_scale_of([], stands, (0.7, 0.0), discs=met_anyway) == 1.0


def test_discs_are_in_the_robots_frame_and_parts_of_the_robot_are_none():
    one = np.ones(2)
    movers = Movers(
        id=one,
        x=np.array([1.0, 2.0]),
        y=np.array([1.0, 3.0]),
        vx=0.0 * one,
        vy=0.5 * one,
        radius=0.3 * one,
        covariance=np.array([[0.1, 0.2, 0.3], [0.01, 0.02, 0.03]]),
        is_certain=one > 0.0,
    )
    robot_pose = (1.0, 1.0, 0.5 * math.pi)
    (seen,) = tracked_discs(movers, BODY.planes, robot_pose, 0.1, 1.5)
    values = [seen[name] for name in ("x", "y", "vx", "vy", "radius", "pp", "pv", "vv")]
    assert values == pytest.approx([2.0, -1.0, 0.5, 0.0, 0.3, 0.01, 0.02, 0.03])
    assert (seen["acceleration"], seen["age"]) == (1.5, 0.1)


def test_what_moves_is_not_matched_as_what_stands():
    ranges = np.array([1.0, 1.0, 2.0, 2.0, np.inf], np.float32)
    scan = LaserScan(0.0, 0.0, 0.3, 0.1, 5.0, ranges, (0.0, 1.0, 0.0))
    one = np.ones(1)
    movers = Movers(one, 1.1 * one, one, one, one, 0.15 * one, np.zeros((1, 3)), one > 0.0)
    unmatched = without_movers(scan, movers).ranges
    assert np.isnan(unmatched).tolist() == [True, True, False, False, False]
    assert (unmatched[2:] == ranges[2:]).all()


@pytest.mark.parametrize(
    ("x", "y", "meets"),
    [
        (FRONT + RADIUS - 0.01, 0.0, True),
        (FRONT + RADIUS + 0.01, 0.0, False),
        (0.0, SIDE + RADIUS - 0.01, True),
        # Beside a corner, where the half planes alone would count it
        (FRONT + 0.8 * RADIUS, SIDE + 0.8 * RADIUS, False),
        (FRONT + 0.6 * RADIUS, SIDE + 0.6 * RADIUS, True),
        (0.0, 0.0, True),
    ],
)
def test_a_disc_meets_the_body_within_its_radius(x, y, meets):
    body = BODY.planes, BODY.edge, 0.0
    assert may_meet(disc(x, y), *body, AHEAD, 0.0) == meets
    assert will_meet(disc(x, y), *body, AHEAD, 0.0) == meets
    # The body is turned to the left, so that its front is where its left side was.
    turned = BodyPose(0.0, 0.0, 0.0, 1.0)
    assert may_meet(disc(-y, x), *body, turned, 0.0) == meets


@pytest.mark.parametrize(("arrival", "meets"), [(1.35, True), (1.45, False)])
def test_what_comes_counts_for_1_4_s_after_a_stop(arrival, meets):
    """It arrives at the front at 1 m/s. What comes later leaves the base the time to drive on."""
    comes = disc(FRONT + RADIUS + arrival, 0.0, vx=-1.0)
    assert will_meet(comes, BODY.planes, BODY.edge, 0.0, AHEAD, 0.0) == meets
