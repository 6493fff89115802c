"""Tests of both simulators: speeds, command time-out, contacts, odometry, repetition with the same
seed.
"""

import itertools
import subprocess
import sys
from dataclasses import replace
from math import cos, hypot, isfinite, pi, sin
from typing import NamedTuple

import numpy as np
import pytest

import sim_bridge
from applr_ros1 import robots
from applr_ros1.common.angles import normalize_angle
from applr_ros1.robots import geometry
from applr_ros1.robots.robot import OdometryErrors
from sim_bridge import bullet_scene
from sim_bridge.odometry import Odometry
from sim_bridge.passers_by import PassersBy
from tests.support import HANGS
from tests.support.refusals import refused
from tests.support.scenes import STEP, drive, small_world
from worlds import Mover

NAMES = ["kinematic", "pybullet"]
JACKAL = robots.load("jackal")
OPEN = small_world()


def both(**options):
    """Return a fixture with each simulator in turn."""

    @pytest.fixture(scope="module", params=NAMES)
    def made(request):
        made = sim_bridge.make(request.param, **options)
        yield made
        made.close()

    return made


simulator = both()
on_plain_ground = both(ground=0.0)


def numbers(state):
    """Return all numbers of a state."""
    return (
        state.time,
        *state.pose,
        *state.twist,
        *state.odom_pose,
        *state.odom_twist,
        *state.imu,
        state.contact,
    )


# -- starts ----------------------------------------------------------------------------------------
def test_a_reset_stands_at_the_start_with_odometry_parallel_to_the_world(simulator):
    state = simulator.reset(small_world(start=(3.0, -2.0, 2.5)), 0)
    assert state.pose == (3.0, -2.0, 2.5)
    assert state.odom_pose == (0.0, 0.0, 2.5)
    assert state.time == 0.0
    assert state.twist == (0.0, 0.0)
    assert not state.contact
    assert simulator.to_odom((1.5, -2.0, 3.0)) == (-1.5, 0.0, 3.0)


def test_a_reset_to_another_start_drives_in_its_direction(simulator):
    start_pose = (1.0, 2.0, 0.5)
    assert simulator.reset(OPEN, 0, start_pose).pose == start_pose
    x, y, _ = drive(simulator, 0.5, 0.0, 2.0).pose
    start_x, start_y, heading = start_pose
    dx = x - start_x
    dy = y - start_y
    across = np.cos(heading) * dy - np.sin(heading) * dx
    assert across == pytest.approx(0.0, abs=0.05)
    assert x > 1.4


@pytest.mark.parametrize("name", NAMES)
def test_randomised_starts_stay_within_their_bounds_and_follow_the_seed(name):
    simulator = sim_bridge.make(name, start_xy=0.2, start_yaw=0.3)
    start_pose = (1.0, 2.0, 0.5)
    scene = small_world(start=start_pose)
    poses = []
    for seed in range(20):
        poses.append(simulator.reset(scene, seed).pose)
    largest_offset = np.abs(np.subtract(poses, start_pose)).max(axis=0)
    assert (largest_offset <= (0.2, 0.2, 0.3)).all()
    assert (largest_offset > (0.1, 0.1, 0.15)).all()
    assert simulator.reset(scene, 5).pose == poses[5]
    # A second close does nothing.
    simulator.close()
    simulator.close()


def test_a_teleported_robot_stands_while_time_and_odometry_go_on(simulator):
    simulator.reset(small_world(start=(1.0, 1.0, 0.3)), 0)
    earlier = drive(simulator, 0.5, 0.1, 2.0)
    teleported = simulator.teleport((-1.0, 2.0, 1.5))
    assert teleported.pose == (-1.0, 2.0, 1.5)
    assert teleported.twist == (0.0, 0.0)
    assert teleported.time == earlier.time
    assert teleported.odom_pose == (*earlier.odom_pose[:2], 1.5)
    assert simulator.to_odom(teleported.pose) == pytest.approx(teleported.odom_pose)
    x, y, _ = simulator.advance(1.0).pose
    assert hypot(x + 1.0, y - 2.0) < 0.2
    _, y, _ = drive(simulator, 0.5, 0.0, 2.0).pose
    assert y > 2.5


# -- speeds ----------------------------------------------------------------------------------------
# Shares of the robot's largest speed and yaw rate: straight on, turns in place, and curves
SPEEDS = (0.05, 0.1, 0.25, 0.5, 0.75, 1.0, -0.05, -0.25)
# 0.785 is 3.14 rad/s, the largest turn rate of the Jackal's planners, of its 4 rad/s.
TURNS = (0.0785, 0.15, 0.25, 0.3925, 0.5, 0.625, 0.785, -0.0785, -0.3925, -0.785)
CURVE_SPEEDS = (0.05, 0.125, 0.25, 0.5, 0.75, 1.0)
CURVE_TURNS = (0.05, 0.15, -0.25, 0.3925, 0.785)


def commands(robot):
    """Yield commands (v, w) [m/s, rad/s] like those of planners, with curves up to the friction
    limit grip_limit.
    """
    max_speed = robot.base.max_speed
    max_yaw_rate = robot.base.max_yaw_rate
    for share in SPEEDS:
        yield max_speed * share, 0.0
    for share in TURNS:
        yield 0.0, max_yaw_rate * share
    for speed_share, turn_share in itertools.product(CURVE_SPEEDS, CURVE_TURNS):
        v = max_speed * speed_share
        w = max_yaw_rate * turn_share
        if abs(v * w) <= robot.simulation.grip_limit:
            yield v, w


class Driven(NamedTuple):
    """Motion of a simulated robot: speed [m/s], yaw rate [rad/s], and the largest distance [m] of
    base_link from its start during the first full turn.
    """

    v: float
    w: float
    drift: float


def driven(simulator, v, w, seconds=6.0, seeds=1):
    """Return the Driven of a command after one second of acceleration, averaged over seeds."""
    runs = []
    for seed in range(seeds):
        simulator.reset(OPEN, seed)
        start_x, start_y, start_yaw = drive(simulator, v, w, 1.0).pose
        earlier_x = start_x
        earlier_y = start_y
        earlier_yaw = start_yaw
        distance_ahead = 0.0
        turned = 0.0
        drift = 0.0
        for _ in range(int(round(seconds / STEP))):
            x, y, yaw = drive(simulator, v, w, STEP).pose
            # The robot moves on an arc, whose chord has the heading of its middle. In a step, it is
            # as long as the arc but for a thousandth.
            turn = normalize_angle(yaw - earlier_yaw)
            middle_yaw = earlier_yaw + turn / 2
            dx = x - earlier_x
            dy = y - earlier_y
            distance_ahead += dx * cos(middle_yaw) + dy * sin(middle_yaw)
            turned += turn
            if abs(turned) <= 2 * pi:
                drift = max(drift, hypot(x - start_x, y - start_y))
            earlier_x, earlier_y, earlier_yaw = x, y, yaw
        runs.append((distance_ahead / seconds, turned / seconds, drift))
    return Driven(*np.mean(runs, axis=0))


def error(simulator, v, w, **options):
    """Return the largest relative error of the driven speed and yaw rate."""
    measured = driven(simulator, v, w, **options)
    errors = []
    if v:
        errors.append(abs(measured.v / v - 1.0))
    if w:
        errors.append(abs(measured.w / w - 1.0))
    return max(errors)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("name", "robot"),
    [
        pytest.param("pybullet", "jackal", marks=pytest.mark.slow),
        *itertools.product(["kinematic"], robots.NAMES),
    ],
)
def test_driven_speeds_are_the_commanded_ones_within_five_percent(name, robot):
    on_even_ground = sim_bridge.make(name, robot=robot, slip=0.0, ground=0.0)
    for v, w in commands(on_even_ground.robot):
        assert error(on_even_ground, v, w, seconds=3.0) < 0.05, (v, w)


@pytest.mark.heavy
def test_speeds_on_uneven_ground_are_the_commanded_ones_on_average(on_plain_ground):
    for v, w in (
        (0.5, 0.0),
        (0.0, 1.57),
        (0.5, 0.6),
        (1.0, -1.0),
    ):
        assert error(on_plain_ground, v, w, seeds=4) < 0.05, (v, w)


def test_a_turn_in_place_drifts_by_centimetres(on_plain_ground):
    for w in (0.6, 1.57, -1.57):
        assert 0.02 < driven(on_plain_ground, 0.0, w, seconds=8.0).drift < 0.2


def test_curves_beyond_the_friction_limit_slide_outwards(simulator):
    measured = driven(simulator, 2.0, 3.14)
    assert measured.v * measured.w < 5.5
    assert measured.v < 1.9


# -- commands --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("v", "w"), [(2.0, 0.0), (0.5, 1.0)])
def test_stops_a_quarter_second_after_the_last_command(simulator, v, w):
    simulator.reset(OPEN, 1)
    drive(simulator, v, w, 1.0)
    # The last command is still in force.
    assert hypot(*simulator.advance(0.20).twist) > 0.1
    # Braking from 2 m/s takes .41 s at the friction limit.
    simulator.advance(0.55)
    assert hypot(*simulator.state.twist) < 0.01
    pose = simulator.state.pose
    simulator.advance(1.0)
    assert np.allclose(simulator.state.pose, pose, atol=1e-3)


@pytest.mark.parametrize(
    ("command", "limited"),
    [
        ((9.0, 0.0), (2.0, 0.0)),
        ((-9.0, 0.0), (-2.0, 0.0)),
        ((0.0, 9.0), (0.0, 4.0)),
        ((0.0, -9.0), (0.0, -4.0)),
    ],
)
def test_a_base_drives_no_faster_than_its_largest_speed_and_yaw_rate(command, limited):
    assert (JACKAL.base.max_speed, JACKAL.base.max_yaw_rate) == (2.0, 4.0)
    simulator = sim_bridge.make("kinematic")
    states = []
    for v, w in (command, limited):
        simulator.reset(OPEN, 0)
        states.append(numbers(drive(simulator, v, w, 1.0)))
    assert states[0] == states[1]


def test_a_base_without_a_command_timeout_follows_its_last_command():
    base = JACKAL.base.model_copy(update={"command_timeout": 0.0})
    simulator = sim_bridge.make("kinematic", replace(JACKAL, base=base))
    simulator.reset(OPEN, 0)
    simulator.command(0.5, 0.0)
    speed, _ = simulator.advance(5.0).twist
    assert speed == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("late_steps", range(12))
def test_a_late_command_comes_into_force_in_the_same_step_however_the_time_is_divided(late_steps):
    # A step of physics lasts for 1/240 s, and twelve of them for a cycle. In one of these cases the
    # command comes into force in the last step of a cycle.
    poses = []
    # In single steps, in twelves, and without latency until as many steps earlier
    for steps, latency in ((1, late_steps), (12, late_steps), (1, 0)):
        simulator = sim_bridge.make("kinematic", latency=latency / 240.0)
        simulator.reset(OPEN, 0)
        simulator.command(0.5, 0.0)
        for _ in range((48 - late_steps + latency) // steps):
            state = simulator.advance(steps / 240.0)
        poses.append(state.pose)
    in_single_steps, in_twelves, prompt = poses
    x, _, _ = in_twelves
    assert x > 0.01
    assert in_twelves == pytest.approx(in_single_steps, abs=1e-9)
    assert prompt == pytest.approx(in_single_steps, abs=1e-3)


# -- contact ---------------------------------------------------------------------------------------
def test_a_wall_stops_the_robot_and_is_reported(simulator):
    wall = (1.0, 0.0, 0.0, 0.2, 4.0)
    simulator.reset(small_world(boxes=[wall]), 0)
    assert not drive(simulator, 0.5, 0.0, 0.8).contact

    state = drive(simulator, 0.5, 0.0, 3.0)

    assert state.contact
    assert not state.flipped
    x, _, _ = state.pose
    front = geometry.bounding_box(JACKAL).front
    assert x == pytest.approx(0.9 - front, abs=0.02)
    assert abs(state.twist[0]) < 0.05
    # The contact ends in reverse.
    assert not drive(simulator, -0.5, 0.0, 1.0).contact
    # The wheels kept turning at the wall.
    assert state.odom_pose[0] > 1.2


def test_the_robot_slides_along_a_wall_that_it_hits_at_a_low_angle(simulator):
    wall = (2.0, -0.15, 0.12, 4.0, 0.2)
    simulator.reset(small_world(boxes=[wall]), 2)
    contacts = [drive(simulator, 0.5, 0.0, STEP).contact for _ in range(120)]
    assert sum(contacts) > 60
    x, _, yaw = simulator.state.pose
    assert x > 2.8
    assert yaw == pytest.approx(0.12, abs=0.01)


def test_the_robot_turns_flat_onto_a_wall_that_it_hits_at_a_high_angle(simulator):
    wall = (1.5, 0.0, 0.5, 4.0, 0.2)
    simulator.reset(small_world(boxes=[wall]), 2)
    state = drive(simulator, 0.5, 0.0, 6.0)
    _, _, yaw = state.pose
    assert yaw == pytest.approx(0.5 - pi / 2, abs=0.01)
    assert abs(state.twist[0]) < 0.02


@pytest.mark.parametrize("name", robots.NAMES)
def test_the_body_in_pybullet_is_the_described_box(name):
    robot = robots.load(name)
    client = bullet_scene.connect()
    body_id = bullet_scene.build_robot(client, robot, (0.0, 0.0, 0.0))
    lowest, highest = np.array(client.getAABB(body_id, -1))  # -1: the body without its wheels
    assert highest - lowest == pytest.approx(robot.body.size, abs=1e-6)
    centre = (lowest + highest) / 2
    assert centre[:2] == pytest.approx(robot.body.centre, abs=1e-3)
    client.disconnect()


def with_mass_at(*place):
    """Return PyBullet's simulator of a Jackal whose body has its centre of mass at x, y, z [m]."""
    body = JACKAL.body.model_copy(update={"com": place})
    return sim_bridge.make("pybullet", replace(JACKAL, body=body))


def test_a_robot_with_its_mass_on_one_side_stands_where_it_was_placed():
    simulator = with_mass_at(0.0, 0.05, 0.08)
    for start in ((1.0, 2.0, pi / 2), (1.0, 2.0, 0.0)):
        simulator.reset(small_world(start=start), 0)
        assert simulator.advance(0.1).pose == pytest.approx(start, abs=1e-3)
    simulator.close()


def test_a_robot_that_falls_over_is_reported():
    # Its mass is a metre above the ground, and the axles are 0.26 m apart.
    simulator = with_mass_at(0.0, 0.0, 1.0)
    simulator.reset(OPEN, 0)
    assert not simulator.advance(STEP).flipped
    assert drive(simulator, 2.0, 0.0, 1.0).flipped
    assert not simulator.reset(OPEN, 0).flipped
    simulator.close()


def test_a_moving_cylinder_is_seen_and_pushes_the_robot(simulator):
    # Given: a cylinder that comes from ahead at 0.5 m/s: time, x, y
    mover = Mover(0.5, ((0.0, 3.0, 0.0), (20.0, -7.0, 0.0)))
    simulator.reset(small_world(movers=[mover]), 0)

    # Then: its position and the beam straight ahead agree, and again after a second
    laser_x, _, _ = JACKAL.laser.pose
    for _ in range(2):
        x, y, radius = simulator.passers_by.circles(simulator.state.time)[0]
        assert (x, y) == pytest.approx(mover.position(simulator.state.time))
        assert simulator.scan()[360] == pytest.approx(x - radius - laser_x, abs=0.02)
        simulator.advance(1.0)

    # When: the robot stands in its way
    contacts = [drive(simulator, 0.0, 0.0, STEP).contact for _ in range(120)]

    # Then: it is pushed along or aside
    assert any(contacts)
    assert not any(contacts[:60])
    x, y, _ = simulator.state.pose
    assert x < -0.3 or abs(y) > 0.3
    assert hypot(x, y) > 0.68


@pytest.mark.parametrize("looks", [True, False])
def test_who_looks_goes_round_a_robot_that_stands(simulator, looks):
    # Given: somebody who walks over the place of the robot, and one who looks at a telephone
    walker = Mover(0.25, ((0.0, 3.0, 0.1), (10.0, -7.0, 0.1)), looks=looks)
    simulator.reset(small_world(movers=[walker]), 0)
    contacts = []
    beams = []
    beside = []
    for _ in range(120):
        contacts.append(drive(simulator, 0.0, 0.0, STEP).contact)
        x, y, radius = simulator.passers_by.circles(simulator.state.time)[0]
        if abs(x) < 0.5:
            laser_x, laser_y, _ = JACKAL.laser.pose_for(simulator.state.pose)
            beside.append(hypot(x - laser_x, y - laser_y) - radius)
            beams.append(simulator.scan().min())

    # Then: only who looks passes without a contact, and is seen where he walks
    assert any(contacts) == (not looks)
    assert x < -1.0
    if looks:
        assert beams == pytest.approx(beside, abs=0.03)


@pytest.mark.parametrize(
    ("ahead", "aside", "step"),
    [
        (1.1, 0.0, -0.5),
        (0.3, 0.69, -0.5),
        (1.1, -0.1, 0.5),
        # Not seen yet, beside the way, and passed
        (1.7, 0.0, 0.0),
        (0.3, 0.71, 0.0),
        (-0.7, 0.0, 0.0),
    ],
)
def test_who_looks_waits_while_a_robot_is_in_the_way(ahead, aside, step):
    # Given: somebody who walks along x, and a robot in the way from 2 to 3 s; both of radius 0.3 m
    mover = Mover(0.3, ((0.0, 0.0, 0.0), (5.0, 5.0, 0.0), (10.0, 10.0, 0.0)), looks=True)
    passers_by = PassersBy(small_world(movers=[mover]), 0.3)
    x, _, _ = passers_by.circles(2.0)[0]
    passers_by.look(2.0, (x + ahead, aside, 0.0))
    passers_by.look(3.0, (99.0, 0.0, 0.0))

    # Then: the way goes on a second later, and back to the path
    delay = 1.0 if step else 0.0
    for time, shift in ((3.0, step), (4.0, 0.5 * step)):
        x, _ = mover.position(time - delay)
        assert passers_by.circles(time)[0] == pytest.approx((x, shift, 0.3))


def test_a_cylinder_that_starts_its_animation_again_pushes_nothing_on_the_way():
    # Given: a cylinder that goes round the left side of a robot, from ahead of it to behind it
    mover = Mover(0.2, ((0.0, 0.55, 0.0), (1.0, 0.0, 2.0), (2.0, -0.55, 0.0)))
    simulator = sim_bridge.make("kinematic")
    simulator.reset(small_world(movers=[mover]), 0)

    # When: it starts again, on the other side of the robot
    contacts = [drive(simulator, 0.0, 0.0, STEP).contact for _ in range(60)]

    # Then: it has not touched the robot
    assert not any(contacts)
    assert simulator.state.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_a_cylinder_is_where_it_stands_and_not_where_it_has_passed(simulator):
    # Given: a cylinder that passes the robot, and then stands on its left
    mover = Mover(0.3, ((0.0, 1.0, 0.0), (4.0, 1.0, 6.0)), repeat=False)
    simulator.reset(small_world(movers=[mover]), 0)
    drive(simulator, 0.0, 0.0, 5.0)

    # When: the robot is put at places along the cylinder's way
    pushed_from = []
    for y in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.8):
        simulator.teleport((1.0, y, 0.0))
        state = drive(simulator, 0.0, 0.0, 0.2)
        if hypot(state.pose[0] - 1.0, state.pose[1] - y) > 0.01:
            pushed_from.append(y)

    # Then: it is pushed away only from the cylinder's last place
    assert pushed_from == [5.8]


def test_random_commands_enter_no_obstacle(simulator):
    rng = np.random.default_rng(5)
    angles = np.linspace(0, 2 * pi, 40)
    # A ring of posts without a gap that the robot fits through
    ring_posts = np.column_stack(
        [
            0.9 * np.cos(angles),
            0.9 * np.sin(angles),
            np.full(40, 0.075),
        ]
    )
    simulator.reset(small_world(ring_posts), 0)
    for _ in range(30):
        v = rng.uniform(-0.5, 2.0)
        w = rng.uniform(-3, 3)
        state = drive(simulator, v, w, 0.5)
        x, y, _ = state.pose
        assert hypot(x, y) < 0.85
        assert all(map(isfinite, state.pose))


# -- frames and odometry ---------------------------------------------------------------------------


def test_odometry_can_be_set(simulator):
    simulator.reset(small_world(start=(0.0, 0.0, 1.0)), 0)
    simulator.set_odometry((5.0, 6.0, 0.0))
    assert simulator.state.odom_pose == (5.0, 6.0, 0.0)
    state = drive(simulator, 0.5, 0.0, 2.0)
    assert np.allclose(state.odom_pose[:2], (5.95, 6.0), atol=0.1)


def test_the_imu_measures_acceleration_and_turn_rate(on_plain_ground):
    simulator = on_plain_ground
    simulator.reset(OPEN, 0)
    simulator.command(1.0, 0.0)
    simulator.advance(0.05)
    # The friction of 0.5 limits the acceleration to half of that of gravity.
    acceleration, _ = simulator.advance(0.05).imu
    assert acceleration == pytest.approx(4.9, abs=0.5)

    state = drive(simulator, 0.0, 1.0, 1.0)
    _, measured_yaw_rate = state.imu
    _, yaw_rate = state.twist
    assert measured_yaw_rate == pytest.approx(yaw_rate, abs=5 * JACKAL.odometry.gyro_noise)
    # The ground is uneven, so that the robot turns a little faster or slower than commanded.
    assert measured_yaw_rate == pytest.approx(1.0, abs=0.2)


# -- laser -----------------------------------------------------------------------------------------
def test_scan_is_taken_at_the_laser_with_its_noise(simulator):
    simulator.reset(small_world([(2.0, 0.0, 0.5)]), 0)
    scans = np.array([simulator.scan() for _ in range(200)])
    assert scans.dtype == np.float32
    assert scans.shape == (200, 720)
    # Both beams in the middle point straight ahead, where the cylinder's rim is.
    laser_x, _, _ = JACKAL.laser.pose
    assert scans[:, 359:361].mean() == pytest.approx(2.0 - 0.5 - laser_x, abs=1e-3)
    assert scans[:, 360].std() == pytest.approx(JACKAL.laser.noise, rel=0.2)
    assert np.isposinf(scans[:, 0]).all()


def test_angles_of_beams_increase_anticlockwise(simulator):
    simulator.reset(small_world([(0.0, 3.0, 0.4)]), 0)
    angle_to_the_left = pi / 2 - JACKAL.laser.first_angle
    left_beam = round(angle_to_the_left / JACKAL.laser.increment)
    assert simulator.scan()[left_beam] == pytest.approx(2.6, abs=0.05)


# -- repetition ------------------------------------------------------------------------------------
def trace(simulator, scene, seed):
    """Return all states and scans of a random drive, as bytes."""
    rng = np.random.default_rng(9)
    samples = []
    simulator.reset(scene, seed)
    for _ in range(40):
        v = rng.uniform(-0.5, 1.5)
        w = rng.uniform(-2.0, 2.0)
        state = drive(simulator, v, w, 0.1)
        state_bytes = np.array(numbers(state)).tobytes()
        samples.append(state_bytes + simulator.scan().tobytes())
    return samples


@pytest.mark.parametrize("name", NAMES)
def test_the_same_world_seed_and_commands_repeat_to_the_last_bit(name):
    simulator = sim_bridge.make(name)
    other_simulator = sim_bridge.make(name)
    rng = np.random.default_rng(1)
    x = rng.uniform(0.5, 3.0, 30)
    y = rng.uniform(-2.0, 2.0, 30)
    posts = np.column_stack([x, y, np.full(30, 0.075)])
    # It goes round the robot, which its next drive must not know.
    walker = Mover(0.25, ((0.0, 1.5, 0.2), (4.0, -2.0, 0.2)), looks=True)
    scene = small_world(posts, movers=[walker])
    first_trace = trace(simulator, scene, 7)
    # A drive elsewhere leaves nothing behind.
    trace(simulator, small_world(start=(1.0, 1.0, 1.0)), 8)
    assert first_trace != trace(simulator, scene, 8)
    assert first_trace == trace(simulator, scene, 7) == trace(other_simulator, scene, 7)
    simulator.close()
    other_simulator.close()


def test_the_length_of_a_step_does_not_matter(simulator):
    poses = []
    for step in (0.05, 0.1, 0.025):
        simulator.reset(OPEN, 0)
        poses.append(drive(simulator, 0.7, 0.5, 2.0, step).pose)
    assert np.allclose(poses[0], poses[1])
    assert np.allclose(poses[0], poses[2])
    assert simulator.state.time == pytest.approx(2.0)


# -- randomisation and mistakes --------------------------------------------------------------------
def test_randomised_values_stay_within_their_bounds():
    simulator = sim_bridge.make("kinematic", latency=(0.0, 0.1), friction=(0.5, 1.5))
    latencies = []
    frictions = []
    for seed in range(50):
        simulator.reset(OPEN, seed)
        latencies.append(simulator.drawn.latency)
        frictions.append(simulator.drawn.friction)
    assert 0.0 <= min(latencies) < 0.03
    assert 0.07 < max(latencies) <= 0.1
    assert 0.5 <= min(frictions) < 0.8
    assert 1.2 < max(frictions) <= 1.5


def acceleration(ground, friction):
    """Return the acceleration [m/s^2] of a Jackal that starts on a ground, limited by friction."""
    simulator = sim_bridge.make(
        "kinematic", ground=ground, slip=0.0, odometry=0.0, friction=friction
    )
    simulator.reset(OPEN, 0)
    simulator.command(1.0, 0.0)
    simulator.advance(0.05)
    forward, _ = simulator.advance(0.05).imu
    return forward


@pytest.mark.parametrize("factor", [0.5, 1.0])
def test_a_drawn_friction_scales_the_acceleration_of_the_tyres(factor):
    # The friction limits it to half of that of gravity.
    assert acceleration(0.0, factor) == pytest.approx(4.9 * factor, rel=0.05)


@pytest.mark.parametrize("ground", [0.25, 0.75])
def test_a_ground_between_two_has_its_share_of_the_force_of_each(ground):
    plain, gazebos = acceleration(0.0, 1.0), acceleration(1.0, 1.0)
    expected = (1.0 - ground) * plain + ground * gazebos
    assert acceleration(ground, 1.0) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("kinematic", {"slip": -1.0}, "slip"),
        ("pybullet", {"latency": (0.2, 0.1)}, "latency"),
        ("gazebo", {}, "pybullet or kinematic"),
    ],
)
def test_wrong_arguments_are_one_line(name, options, words):
    refused(lambda: sim_bridge.make(name, **options), words)


def test_commands_that_are_not_finite_are_one_line(simulator):
    simulator.reset(OPEN, 0)
    for v, w in ((float("nan"), 0.0), (0.0, float("inf"))):
        refused(lambda: simulator.command(v, w), "command")  # noqa: B023


# -- kinematic simulator compared with pybullet ----------------------------------------------------
def test_kinematic_drives_like_pybullet():
    pybullet = sim_bridge.make("pybullet")
    kinematic = sim_bridge.make("kinematic")
    for v, w in (
        (1.0, 0.0),
        (0.0, 1.57),
        (0.5, 1.0),
        (-0.5, 0.0),
    ):
        pybullet_twists = twists(pybullet, v, w)
        kinematic_twists = twists(kinematic, v, w)
        differences = np.subtract(pybullet_twists, kinematic_twists)
        assert np.abs(differences).max() < 0.05
    pybullet.close()


def twists(simulator, v, w):
    """Return the twists (26, 2) while a robot accelerates for a second, and then brakes."""
    simulator.reset(OPEN, 3)
    commands = [(v, w)] * 20 + [(0.0, 0.0)] * 6
    return [drive(simulator, *command, STEP).twist for command in commands]


def among_obstacles(simulator, seed):
    """Run two random commands between random posts, and in front of a long box if the seed is even.
    Return the last pose, and whether there was contact.
    """
    rng = np.random.default_rng(seed)
    # None begins within the robot.
    posts = [(x, y, 0.075) for x, y in rng.uniform(-0.9, 0.9, (16, 2)) if hypot(x, y) > 0.48]
    box = (1.1, rng.uniform(-0.4, 0.4), rng.uniform(-0.7, 0.7), 0.3, 2.0)
    scene = small_world(posts) if seed % 2 else small_world(boxes=[box])
    simulator.reset(scene, seed)
    has_touched = False
    for _ in range(2):
        v, w = rng.uniform((-0.3, -0.7), (1.5, 0.7))
        for _ in range(30):
            has_touched |= drive(simulator, v, w, STEP).contact
    return simulator.state.pose, has_touched


@pytest.mark.slow
def test_kinematic_contacts_end_like_pybullets():
    pybullet = sim_bridge.make("pybullet")
    kinematic = sim_bridge.make("kinematic")
    distances = []  # between the last poses of the drives with a contact [m]
    turns = []
    equal_count = 0
    seeds = range(1000, 1030)
    for seed in seeds:
        bullet_pose, bullet_touched = among_obstacles(pybullet, seed)
        kinematic_pose, kinematic_touched = among_obstacles(kinematic, seed)
        equal_count += bullet_touched == kinematic_touched
        if bullet_touched:
            dx, dy, turn = np.subtract(kinematic_pose, bullet_pose)
            distances.append(hypot(dx, dy))
            turns.append(abs(normalize_angle(turn)))
    pybullet.close()
    assert len(distances) > 12
    assert np.median(distances) < 0.02
    assert np.median(turns) < 0.012
    assert equal_count > 0.9 * len(seeds)


@pytest.mark.parametrize("name", ["turtlebot3_burger", "husky"])
def test_other_robots_drive_alike_in_both(name):
    robot = robots.load(name)
    v = 0.5 * robot.base.max_speed
    w = 0.3 * robot.base.max_yaw_rate
    end_poses = []
    for simulator in (
        sim_bridge.make("kinematic", robot=robot),
        sim_bridge.make("pybullet", robot=name),
    ):
        simulator.reset(OPEN, 3)
        end_poses.append(drive(simulator, v, w, 2.0).pose)
        assert simulator.scan().shape == (robot.laser.beams,)
        simulator.close()
    kinematic_end, pybullet_end = end_poses
    assert np.allclose(kinematic_end, pybullet_end, atol=0.01)


WITHOUT_PYBULLET = """
import sys
sys.modules['pybullet'] = None
import sim_bridge
sim_bridge.make('kinematic')
try:
    sim_bridge.make('pybullet')
except ModuleNotFoundError as error:
    print(error.name)
"""


def test_kinematic_needs_no_pybullet():
    finished = subprocess.run(
        [sys.executable, "-c", WITHOUT_PYBULLET],
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert finished.returncode == 0
    assert finished.stdout == "pybullet\n"
    assert finished.stderr == ""


# -- dead band -------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", NAMES)
def test_a_base_with_a_dead_band_takes_smaller_speeds_and_turn_rates_as_0(name):
    assert JACKAL.base.dead_band == (0.0, 0.0)
    base = JACKAL.base.model_copy(update={"dead_band": (0.1, 0.5)})
    simulator = sim_bridge.make(name, replace(JACKAL, base=base))
    for command, moves, turns in (
        ((0.09, 0.49), False, False),
        ((-0.09, -0.49), False, False),
        ((0.11, 0.4), True, False),
        ((-0.2, 0.0), True, False),
        ((0.05, 0.8), False, True),
        ((0.2, -0.8), True, True),
    ):
        simulator.reset(OPEN, 0)
        x, y, yaw = drive(simulator, *command, 1.0).pose
        assert (hypot(x, y) > 0.05) == moves, command
        assert (abs(yaw) > 0.1) == turns, command
    simulator.close()


def test_the_slow_error_of_the_heading_has_its_size_and_its_correlation_time():
    errors = OdometryErrors(heading_drift=0.02, heading_time=10.0, heading_noise=0.0)
    odometry = Odometry(errors, 0.0, np.random.default_rng(0))
    # 4,000 correlation times are enough for two digits.
    headings = np.empty(40_000)
    for second in range(len(headings)):
        odometry.integrate(1.0, 0.0, 0.0, 0.0, 0.0)
        _, _, headings[second] = odometry.pose
    assert headings.std() == pytest.approx(0.02, rel=0.1)
    # After one correlation time, 1/e of the correlation is left.
    correlations = np.corrcoef(headings[:-10], headings[10:])
    assert correlations[0, 1] == pytest.approx(np.exp(-1.0), abs=0.1)


@pytest.mark.parametrize(
    ("first_yaw", "last_yaw", "x", "y"),
    [
        (0.0, 0.6, 2.0 * cos(0.3), 2.0 * sin(0.3)),
        (pi - 0.2, -pi + 0.2, -2.0, 0.0),  # from one side of pi to the other
    ],
)
def test_odometry_goes_in_the_middle_direction_of_a_turn(first_yaw, last_yaw, x, y):
    odometry = Odometry(OdometryErrors(), first_yaw, np.random.default_rng(0), scale=0.0)
    odometry.integrate(4.0, 0.5, last_yaw, 0.1, 0.0)
    assert odometry.pose == pytest.approx((x, y, last_yaw))


def test_the_error_of_the_distance_has_its_size_and_stays_during_a_drive():
    errors = OdometryErrors(scale_error=0.02, heading_drift=0.0, heading_noise=0.0)
    rng = np.random.default_rng(0)
    distances = np.empty(2_000)
    for start in range(len(distances)):
        odometry = Odometry(errors, 0.0, rng)
        odometry.integrate(1.0, 1.0, 0.0, 0.0, 0.0)
        distances[start], _, _ = odometry.pose
        odometry.integrate(1.0, 1.0, 0.0, 0.0, 0.0)
        x, _, _ = odometry.pose
        assert x == pytest.approx(2.0 * distances[start])
    assert distances.mean() == pytest.approx(1.0, abs=0.002)
    assert distances.std() == pytest.approx(0.02, rel=0.1)


def test_the_noise_of_heading_and_speed_has_its_size_and_does_not_move_the_position():
    errors = OdometryErrors(heading_noise=0.03, heading_drift=0.0, speed_noise=0.05)
    odometry = Odometry(errors, 0.5 * pi, np.random.default_rng(0))
    headings = np.empty(4_000)
    speeds = np.empty(4_000)
    for sample in range(len(headings)):
        odometry.integrate(0.05, 0.5, 0.5 * pi, 0.0, 0.0)
        x, _, headings[sample] = odometry.pose
        speeds[sample], _ = odometry.twist
        assert x == pytest.approx(0.0, abs=1e-9)
    assert headings.mean() == pytest.approx(0.5 * pi, abs=0.003)
    assert headings.std() == pytest.approx(0.03, rel=0.1)
    assert speeds.mean() == pytest.approx(0.5, abs=0.01)
    assert speeds.std() == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_a_robot_that_drives_against_a_post_turns_towards_the_side_of_the_post(simulator, side):
    post = (0.7, side * 0.12, 0.05)
    simulator.reset(small_world(cylinders=[post]), 0)
    state = drive(simulator, 0.5, 0.0, 3.0)
    assert state.contact
    _, _, yaw = state.pose
    assert side * yaw > 0.1
