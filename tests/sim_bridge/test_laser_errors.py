"""Tests of the errors of simulated lasers, as the fields of section laser describe them."""

from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
import worlds
from applr_ros1.robots import JACKAL
from applr_ros1.robots.folder import RobotError, content_of, described
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import SENSORS_PATH
from applr_ros1.stack.simulated import SimulatedRobot
from tests.support.robots import Script
from tests.support.scenes import small_world

SENSORS = read_yaml(SENSORS_PATH)
MIDDLE = 360  # beam straight ahead of the Jackal
COUNT = 400  # scans of a statistic
LASER_X, _, _ = JACKAL.laser.pose


def simulated(*boxes, scan_noise=1.0, **fields):
    """Return a simulator of a Jackal at 0 that has a laser with errors, but without noise."""
    laser = JACKAL.laser.model_copy(update={"noise": 0.0, **fields})
    robot = replace(JACKAL, laser=laser)
    simulator = sim_bridge.make("kinematic", robot=robot, scan_noise=scan_noise)
    simulator.reset(small_world(boxes=boxes), 4)
    return simulator


def scans_of(*boxes, **fields):
    """Return the exact scan (720,) and scans (COUNT, 720) with errors [m]."""
    simulator = simulated(*boxes, **fields)
    scans = [simulator.scan() for _ in range(COUNT)]
    return simulated(*boxes).scan(), np.array(scans)


def wall_at(distance, width=60.0):
    """Return a wall that is a distance [m] ahead of the laser."""
    return (LASER_X + distance + 0.5, 0.0, 0.0, 1.0, width)


@pytest.mark.parametrize("distance", [2.0, 20.0])
@pytest.mark.parametrize("sensor", [None, "rplidar_a1"])
def test_noise_grows_with_the_range_and_a_draw_scales_that_of_an_unnamed_laser(distance, sensor):
    simulator = simulated(
        wall_at(distance), scan_noise=(3, 5), sensor=sensor, noise=0.004, range_noise=0.001
    )
    ranges = np.array([simulator.scan()[350:370] for _ in range(COUNT)], np.float64)
    assert ranges.mean() == pytest.approx(distance, rel=1e-3)
    factor = 1.0 if sensor else simulator.drawn.scan_noise
    expected = np.hypot(factor * 0.004, 0.001 * distance)
    assert ranges.std(axis=0).mean() == pytest.approx(expected, rel=0.05)


def test_the_error_of_incidence_is_that_of_normal_incidence():
    sees_wall = slice(150, 570)
    exact = simulated(wall_at(2.0)).scan()[sees_wall]
    errors = simulated(wall_at(2.0), incidence_error=0.03).scan()[sees_wall] - exact
    angles = (JACKAL.laser.first_angle + JACKAL.laser.increment * np.arange(720))[sees_wall]
    expected = 0.03 * np.exp(-np.square(np.tan(angles) / 0.18))
    assert errors == pytest.approx(expected, abs=1e-3)


def test_the_same_surfaces_lose_ranges_in_scan_after_scan():
    exact, scans = scans_of(wall_at(4.0), dark=0.3, dropouts=0.4)
    lost = scans != exact
    assert np.isposinf(scans[lost]).all()
    shares = lost[:, np.isfinite(exact)].mean(axis=0)
    is_dark = shares > 0.0
    assert 0.2 < is_dark.mean() < 0.4
    assert shares[is_dark] == pytest.approx(0.4, abs=0.11)


def test_ranges_behind_an_edge_lie_between_both_surfaces():
    exact, scans = scans_of((2.0, 0.0, 0.0, 0.3, 0.3), wall_at(4.0, width=3.0), mixed=0.25)
    on_post = np.flatnonzero(exact < 2.5)
    behind = [on_post[0] - 1, on_post[-1] + 1]
    is_mixed = scans != exact
    assert is_mixed[:, behind].mean() == pytest.approx(0.25, abs=0.05)
    is_mixed[:, behind] = False
    assert not is_mixed.any()
    near = exact[on_post[0]]
    far = exact[behind[0]]
    shares = (far - scans[:, behind]) / (far - near)
    mixed_shares = shares[shares > 0.01]
    assert mixed_shares.mean() == pytest.approx(0.5, abs=0.08)
    assert mixed_shares.max() == pytest.approx(1.0, abs=0.05)


def test_a_late_stamp_gives_the_ranges_of_an_earlier_pose():
    simulator = simulated(wall_at(9.0), stamp_delay=0.1)
    x_positions = []
    for _ in range(40):
        simulator.command(1.0, 0.0)
        x, _, _ = simulator.advance(0.05).pose
        x_positions.append(x)
    assert simulator.scan()[MIDDLE] == pytest.approx(9.0 - x_positions[-3], abs=2e-3)
    assert x_positions[-1] - x_positions[-3] > 0.09
    # What was measured before a teleport would be seen at the wrong place.
    simulator.teleport((2.0, 0.0, 0.0))
    assert simulator.scan()[MIDDLE] == pytest.approx(7.0, abs=1e-3)


def test_a_share_of_the_scans_is_missing_but_never_the_first():
    simulated_robot = SimulatedRobot(simulated(gaps=0.3), Script())
    for seed in range(20):
        simulated_robot.reset(worlds.load("generated:3"), seed)
        assert simulated_robot.cycle().scan is not None
    are_missing = [simulated_robot.cycle().scan is None for _ in range(COUNT)]
    assert np.mean(are_missing) == pytest.approx(0.3, abs=0.06)


def jackal_with(sensor, **fields):
    """Return the Jackal whose file names a sensor, and gives some of its errors itself."""
    content = content_of(JACKAL)
    for field_name in {name for row in SENSORS.values() for name in row}:
        del content["laser"][field_name]
    content["laser"].update(sensor=sensor, **fields)
    return described(content, "jackal", JACKAL.folder)


@pytest.mark.parametrize("name", SENSORS)
def test_a_named_sensor_gives_its_errors_and_changes_nothing_but_the_scans(name):
    robot = jackal_with(name, mixed=0.5)
    assert {**SENSORS[name], "mixed": 0.5}.items() <= robot.laser.model_dump().items()
    states = []
    for driven_robot in (JACKAL, robot):
        simulator = sim_bridge.make("kinematic", robot=driven_robot)
        simulator.reset(worlds.load("generated:3"), 5)
        for _ in range(30):
            simulator.command(0.5, 0.2)
            simulator.advance(0.05)
            simulator.scan()
        states.append(simulator.state)
    assert states[0] == states[1]


def test_an_unknown_sensor_is_answered_with_the_known_ones():
    with pytest.raises(RobotError, match="laser: sensor is 'rplidar': give one of rplidar_a1, "):
        jackal_with("rplidar")
