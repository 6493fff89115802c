"""Tests that a simulated Jackal on ground `gazebo` hits no observed obstacle, whatever the commands."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
from applr_ros1.common.angles import compose
from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.robots import JACKAL
from tests.support.scenes import small_world

STEP_S = 0.02
TOUCHED_M_S = 0.15  # largest allowed contact speed, because wheels slide; without the monitor 0.3 to 1 [m/s]
WALLS = [(4.5, y, 0.1) for y in np.arange(-2.2, 2.3, 0.15)] + [
    (x, side * 2.2, 0.1) for x in np.arange(-2.0, 4.5, 0.3) for side in (-1, 1)
]


def touched(commands, seed, late=0.0, robot=JACKAL, cylinders=WALLS, seconds=7.0):
    """Return the speed [m/s] at which the robot touches a cylinder (0 if it touches none), and its largest speed.

    `commands` yields (time [s], (v, w)). `late` is the age of scan, pose and twist on arrival [s].
    """
    simulator, monitor, laser = sim_bridge.make("kinematic", robot=robot), CollisionMonitor(), robot.laser
    geometry = laser.first_angle, laser.increment, laser.range_min, laser.range_max
    state = simulator.reset(small_world(cylinders), seed)
    due, command = next(commands)
    sent, fastest, on_the_way, known = 0.0, 0.0, [], None
    while state.time < seconds:
        now = state.time
        scan = LaserScan(now, *geometry, simulator.scan(), compose(state.odom_pose, laser.pose))
        on_the_way.append((state, scan))
        while on_the_way and on_the_way[0][1].stamp <= now - late + 1e-9:
            known, scan = on_the_way.pop(0)
            monitor.add_scan(scan)
        if known is not None and now >= due - 1e-9:
            ages = (now - known.time,) * 2
            simulator.command(*monitor.filter(now, known.odom_pose, known.odom_twist, command, ages).command)
            sent, (due, command) = now, next(commands)
        elif known is not None and now - sent > monitor.silence:
            simulator.command(*monitor.braked(now, known.odom_twist[0]))
        speed, state = abs(state.twist[0]), simulator.advance(STEP_S)
        if state.contact:
            return speed, fastest
        fastest = max(fastest, speed)
    return 0.0, fastest


def in_turn(period, *commands):
    """Yield the commands cyclically, one per `period` [s]."""
    return ((step * period, command) for step, command in enumerate(itertools.cycle(commands)))


def at_random(seed):
    """Yield random commands, five to fifty per second."""
    rng, due = np.random.default_rng(seed), 0.0
    while True:
        yield due, tuple(rng.uniform(-2.0, 2.0, 2))
        due += rng.uniform(0.02, 0.2)


MAD = (2.0, 4.0), (-2.0, -4.0), (2.0, -4.0), (2.0, 0.0)  # commands that change faster than the base can follow


@pytest.mark.parametrize(
    ("commands", "late", "seeds"),
    [
        (lambda seed: in_turn(0.1, *MAD), 0.0, (0, 1, 2, 3, 4, 5)),
        (lambda seed: in_turn(0.1, *MAD), 0.2, (0, 1, 2)),
        (lambda seed: in_turn(0.16, *MAD), 0.0, (5, 9)),
        (lambda seed: in_turn(0.2, (2.0, 0.0)), 0.0, (0, 1, 2)),
        (lambda seed: in_turn(0.3, (2.0, 0.0)), 0.2, (0, 1)),
        (at_random, 0.1, (0, 1, 2)),
    ],
    ids=["alternating", "alternating and late", "alternating and rare", "rare", "rare and late", "at random"],
)
def test_no_command_sequence_hits_a_wall(commands, late, seeds):
    drives = [touched(commands(seed), seed, late) for seed in seeds]
    assert max(speed for speed, _ in drives) <= TOUCHED_M_S
    assert min(fastest for _, fastest in drives) > 0.6, "it drives"


@pytest.mark.parametrize("beams", [60, 90])
def test_a_leg_between_the_beams_of_a_coarse_laser_is_not_hit(beams):
    """A leg of 2 cm straight ahead stays between two beams on the whole straight drive."""
    laser = JACKAL.laser.model_copy(update=dict(beams=beams, first_angle=-3.1, last_angle=3.1))
    legs = [(1.0, 0.11 * (k - 1) + 0.013, 0.01) for k in range(4)]
    for leg in legs:
        drive = in_turn(0.05, (1.5, 0.0))
        assert touched(drive, 0, 0.0, replace(JACKAL, laser=laser), [leg, *WALLS], 9.0)[0] <= TOUCHED_M_S
