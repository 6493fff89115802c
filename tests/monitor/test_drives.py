"""Tests that a simulated Jackal hits no observed obstacle, whatever the commands.

The ground is `gazebo`.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

import sim_bridge
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.robots import JACKAL
from tests.support.scenes import small_world

STEP_S = 0.02  # time between two advances of the simulation [s]
# Largest allowed contact speed, because wheels slide [m/s]; without the monitor it is 0.3 to 1.
TOUCHED_M_S = 0.15


def closed_room():
    """Return the cylinders (x, y, radius) [m] of a wall 4.5 m ahead and of two walls beside it."""
    walls = [(4.5, y, 0.1) for y in np.arange(-2.2, 2.3, 0.15)]
    for x in np.arange(-2.0, 4.5, 0.3):
        walls += [(x, -2.2, 0.1), (x, 2.2, 0.1)]
    return walls


WALLS = closed_room()


class Drive(NamedTuple):
    """Speed at which a cylinder was touched, 0 if none was, and largest speed [m/s]."""

    contact_speed: float
    fastest: float


def drive(
    commands,
    seed,
    late=0.0,
    robot=JACKAL,
    cylinders=WALLS,
    seconds=7.0,
    simulator_name="kinematic",
    measured=None,
):
    """Return the Drive of a monitored robot.

    `commands` yields (time [s], (v, w)). `late` is the age of scan, pose and twist on arrival [s].
    `measured`, if any, changes each LaserScan.
    """
    simulator = sim_bridge.make(simulator_name, robot=robot)
    monitor = CollisionMonitor()
    state = simulator.reset(small_world(cylinders), seed)
    due, command = next(commands)
    last_command = 0.0
    fastest = 0.0
    on_the_way = []  # states and scans that have not arrived yet
    known_state = None  # latest state that has
    while state.time < seconds:
        scan = simulator.laser_scan()
        if measured:
            scan = measured(scan)
        on_the_way.append((state, scan))
        # Scan and pose arrive together, after `late`.
        while on_the_way and on_the_way[0][1].stamp <= state.time - late + 1e-9:
            known_state, scan = on_the_way.pop(0)
            monitor.add_scan(scan)

        if known_state is not None and state.time >= due - 1e-9:
            age = state.time - known_state.time
            verdict = monitor.filter(
                state.time,
                known_state.odom_pose,
                known_state.odom_twist,
                command,
                (age, age),
            )
            simulator.command(*verdict.command)
            last_command = state.time
            due, command = next(commands)
        # No command for so long: the node's timer brakes the base.
        elif known_state is not None and state.time - last_command > monitor.silence:
            v, _ = known_state.odom_twist
            simulator.command(*monitor.braked(state.time, v))

        speed = abs(state.twist[0])
        state = simulator.advance(STEP_S)
        if state.contact:
            return Drive(speed, fastest)
        fastest = max(fastest, speed)
    return Drive(0.0, fastest)


def in_turn(period, *commands):
    """Yield the commands cyclically, one per `period` [s]."""
    for step, command in enumerate(itertools.cycle(commands)):
        yield step * period, command


def at_random(seed):
    """Yield random commands, five to fifty per second."""
    rng = np.random.default_rng(seed)
    due = 0.0
    while True:
        yield due, tuple(rng.uniform(-2.0, 2.0, 2))
        due += rng.uniform(0.02, 0.2)


def alternating(period):
    """Yield commands that change faster than the base can follow, one per `period` [s]."""
    return in_turn(period, (2.0, 4.0), (-2.0, -4.0), (2.0, -4.0), (2.0, 0.0))


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("commands", "late", "seeds"),
    [
        (lambda seed: alternating(0.1), 0.0, (0, 1, 2, 3, 4, 5)),
        (lambda seed: alternating(0.1), 0.2, (0, 1, 2)),
        (lambda seed: alternating(0.16), 0.0, (5, 9)),
        (lambda seed: in_turn(0.2, (2.0, 0.0)), 0.0, (0, 1, 2)),
        (lambda seed: in_turn(0.3, (2.0, 0.0)), 0.2, (0, 1)),
        (at_random, 0.1, (0, 1, 2)),
    ],
    ids=[
        "alternating",
        "alternating and late",
        "alternating and rare",
        "rare",
        "rare and late",
        "at random",
    ],
)
def test_no_command_sequence_hits_a_wall(commands, late, seeds):
    drives = [drive(commands(seed), seed, late) for seed in seeds]
    assert max(driven.contact_speed for driven in drives) <= TOUCHED_M_S
    # A monitor that lets nothing pass would hit nothing, either.
    assert min(driven.fastest for driven in drives) > 0.6


def without_returns(share, seed, nearer):
    """Return a function that takes away the returns nearer than `nearer` [m] straight ahead.

    It does so in a share of the scans.
    """
    rng = np.random.default_rng(seed)

    def measured(scan):
        if rng.random() >= share:
            return scan
        x, y, yaw = scan.sensor_pose
        bearings = yaw + scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        is_dark = abs(y + scan.ranges * np.sin(bearings)) < 0.5
        is_dark &= x + scan.ranges * np.cos(bearings) < nearer
        return replace(scan, ranges=np.where(is_dark, np.float32(np.inf), scan.ranges))

    return measured


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
@pytest.mark.parametrize(
    ("post", "nearer"),
    [
        pytest.param((3.0, 0.0, 0.05), 4.0, id="a post"),
        pytest.param((9.0, 0.0, 0.05), 9.0, id="the wall"),
    ],
)
def test_what_returns_nothing_in_some_scans_is_not_hit(share, post, nearer):
    """A dark post stands before the wall, or a metre of the wall is dark."""
    for seed in (0, 1, 2):
        driven = drive(
            in_turn(0.05, (2.0, 0.0)),
            seed,
            cylinders=[post, *WALLS],
            seconds=4.0,
            measured=without_returns(share, seed, nearer),
        )
        assert driven.contact_speed <= TOUCHED_M_S
        assert driven.fastest > 1.5


@pytest.mark.heavy
@pytest.mark.parametrize("beams", [60, 90])
def test_a_leg_between_the_beams_of_a_coarse_laser_is_not_hit(beams):
    """A leg of 2 cm straight ahead stays between two beams on the whole straight drive."""
    geometry = dict(beams=beams, first_angle=-3.1, last_angle=3.1)
    robot = replace(JACKAL, laser=JACKAL.laser.model_copy(update=geometry))
    for y in (-0.097, 0.013, 0.123, 0.233):
        leg = (1.0, y, 0.01)
        straight_on = in_turn(0.05, (1.5, 0.0))
        driven = drive(
            straight_on,
            0,
            robot=robot,
            cylinders=[leg, *WALLS],
            seconds=9.0,
        )
        assert driven.contact_speed <= TOUCHED_M_S
