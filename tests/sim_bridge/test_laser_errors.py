"""Tests of the errors of simulated lasers, as the fields of section laser describe them."""

from dataclasses import replace

import numpy as np
import pytest

import sim_bridge
import worlds
from applr_ros1.robots import JACKAL
from applr_ros1.robots.folder import RobotError, content_of, described
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import SENSORS_PATH, Laser
from applr_ros1.stack.simulated import SimulatedRobot
from tests.support.robots import Script
from tests.support.scenes import small_world

SENSOR_NAMES = tuple(read_yaml(SENSORS_PATH))
MIDDLE = 360  # beam straight ahead of the Jackal
COUNT = 400  # scans of a statistic


def laser(**fields):
    """Return the Jackal's laser without noise, but with some errors."""
    return Laser.model_validate({**JACKAL.laser.model_dump(), "noise": 0.0, **fields})


def simulated(obstacles, start=(0.0, 0.0, 0.0), scan_noise=1.0, **fields):
    """Return a simulator of a Jackal that has a laser with errors, among some boxes."""
    robot = replace(JACKAL, laser=laser(**fields))
    simulator = sim_bridge.make("kinematic", robot=robot, scan_noise=scan_noise)
    simulator.reset(small_world(boxes=obstacles, start=start), 4)
    return simulator


def wall_at(distance):
    """Return a wide wall whose face is at a distance [m] from the laser of a robot at 0."""
    laser_x, _, _ = JACKAL.laser.pose
    return (laser_x + distance + 0.5, 0.0, 0.0, 1.0, 60.0)


@pytest.mark.parametrize("distance", [2.0, 20.0])
@pytest.mark.parametrize(("sensor", "factor"), [(None, 3.0), ("rplidar_a1", 1.0)])
def test_noise_grows_with_the_range_and_is_a_named_sensors_own(distance, sensor, factor):
    simulator = simulated(
        [wall_at(distance)],
        scan_noise=3.0,
        sensor=sensor,
        noise=0.004,
        range_noise=0.001,
        dropouts=0.0,
        mixed=0.0,
    )
    scans = np.array([simulator.scan() for _ in range(COUNT)], np.float64)
    measured = scans[:, MIDDLE - 5 : MIDDLE + 6]
    assert measured.mean() == pytest.approx(distance, abs=0.01)
    expected_deviation = np.hypot(factor * 0.004, 0.001 * distance)
    assert measured.std() == pytest.approx(expected_deviation, rel=0.05)


def test_the_error_of_incidence_is_that_of_normal_incidence():
    exact = simulated([wall_at(2.0)]).scan()
    sees_wall = np.isfinite(exact)
    errors = np.zeros(len(exact))
    scan = simulated([wall_at(2.0)], incidence_error=0.03).scan()
    errors[sees_wall] = scan[sees_wall] - exact[sees_wall]
    angles = np.abs(JACKAL.laser.first_angle + JACKAL.laser.increment * np.arange(720))
    assert errors[angles < 0.02] == pytest.approx(0.03, abs=1e-3)
    at_half_the_tangent = np.argmin(np.abs(np.tan(angles[:MIDDLE]) - 0.09))
    assert errors[at_half_the_tangent] == pytest.approx(0.03 * np.exp(-0.25), abs=1e-3)
    assert np.abs(errors[angles > 0.5]).max() < 1e-3


def test_the_same_surfaces_lose_ranges_in_scan_after_scan():
    simulator = simulated([wall_at(4.0), (-5.0, 0.0, 0.0, 1.0, 60.0)], dark=0.3, dropouts=0.4)
    exact = simulated([wall_at(4.0), (-5.0, 0.0, 0.0, 1.0, 60.0)]).scan()
    scans = np.array([simulator.scan() for _ in range(COUNT)])
    returns = np.isfinite(exact)
    assert (scans[:, returns] == exact[returns]).any(axis=0).all()
    assert np.isposinf(scans[:, ~returns]).all()
    lost = np.isposinf(scans[:, returns])
    assert ((scans[:, returns] == exact[returns]) | lost).all()
    shares = lost.mean(axis=0)
    is_dark = shares > 0.0
    assert 0.2 < is_dark.mean() < 0.4
    assert shares[is_dark] == pytest.approx(0.4, abs=0.11)


def test_ranges_behind_an_edge_lie_between_both_surfaces():
    post = (2.0, 0.0, 0.0, 0.3, 0.3)
    wall = (4.5, 0.0, 0.0, 1.0, 3.0)
    simulator = simulated([post, wall], mixed=0.25)
    exact = simulated([post, wall]).scan()
    scans = np.array([simulator.scan() for _ in range(COUNT)])
    first, last = np.flatnonzero(exact < 2.5)[[0, -1]]
    behind = [first - 1, last + 1]
    assert np.array_equal(np.flatnonzero((scans != exact).any(axis=0)), behind)
    ranges = scans[:, behind]
    is_mixed = ranges != exact[behind]
    assert is_mixed.mean() == pytest.approx(0.25, abs=0.05)
    post_range = exact[first]
    wall_range = exact[first - 1]
    mixed_ranges = ranges[is_mixed]
    assert post_range - 0.01 < mixed_ranges.min() < post_range + 0.1
    assert wall_range - 0.1 < mixed_ranges.max() < wall_range + 0.01
    assert mixed_ranges.mean() == pytest.approx(0.5 * (post_range + wall_range), abs=0.15)


def test_a_late_stamp_gives_the_ranges_of_an_earlier_pose():
    simulator = simulated([wall_at(9.0)], stamp_delay=0.1)
    poses = []
    for _ in range(40):
        simulator.command(1.0, 0.0)
        state = simulator.advance(0.05)
        poses.append(state.pose)
    assert simulator.scan()[MIDDLE] == pytest.approx(9.0 - poses[-3][0], abs=2e-3)
    assert poses[-1][0] - poses[-3][0] > 0.09
    assert simulator.laser_scan().sensor_pose == JACKAL.laser.pose_for(state.odom_pose)
    # What was measured before a teleport would be seen at the wrong place.
    simulator.teleport((2.0, 0.0, 0.0))
    assert simulator.scan()[MIDDLE] == pytest.approx(7.0, abs=1e-3)


def test_a_share_of_the_scans_is_missing_but_never_the_first():
    for seed in range(20):
        robot = replace(JACKAL, laser=laser(gaps=0.3))
        robot_in_simulator = SimulatedRobot(sim_bridge.make("kinematic", robot=robot), Script())
        robot_in_simulator.reset(worlds.load("generated:3"), seed)
        assert robot_in_simulator.cycle().scan is not None
    scans = [robot_in_simulator.cycle().scan for _ in range(COUNT)]
    assert np.mean([scan is None for scan in scans]) == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize("name", SENSOR_NAMES)
def test_a_named_sensor_gives_its_errors_and_changes_nothing_but_the_scans(name):
    row = read_yaml(SENSORS_PATH)[name]
    content = content_of(JACKAL)
    for field_name in row:
        del content["laser"][field_name]
    content["laser"].update(sensor=name, mixed=0.5)
    robot = described(content, "jackal", JACKAL.folder)
    assert {**row, "mixed": 0.5}.items() <= robot.laser.model_dump().items()

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
    content = content_of(JACKAL)
    content["laser"]["sensor"] = "rplidar"
    with pytest.raises(RobotError, match="laser: sensor is 'rplidar': give one of rplidar_a1, "):
        described(content, "jackal", JACKAL.folder)
