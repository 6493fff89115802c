"""Tests of the mechanics that both simulators share: loads and friction of wheels and casters."""

from dataclasses import replace

import pytest

from applr_ros1 import robots
from sim_bridge.mechanics import mechanics


@pytest.mark.parametrize("name", robots.NAMES)
def test_an_acceleration_shifts_load_so_that_the_moments_balance(name):
    """Forward acceleration presses the rear down: m a h is the moment of the changed loads."""
    robot_mechanics = mechanics(robots.load(name))
    constants = robot_mechanics.constants
    supports = robot_mechanics.supports
    for shift, lever, place in (
        (supports["shift_x"], constants.lever_x, supports["x"]),
        (supports["shift_y"], constants.lever_y, supports["y"]),
    ):
        # Loads per moment of the acceleration [1/m]: together they carry no more than before.
        load_changes = shift / lever
        assert load_changes.sum() == pytest.approx(0.0, abs=1e-9)
        assert load_changes @ place == pytest.approx(-1.0)


def test_casters_have_a_friction_of_their_own():
    robot = robots.load("turtlebot3_waffle_pi")
    base = robot.base.model_copy(update={"wheel_friction": 0.6, "caster_friction": 0.15})
    supports = mechanics(replace(robot, base=base)).supports
    # Both wheels, and both casters; the ground's friction is that of the wheels.
    assert supports["friction_share"].tolist() == [1.0, 1.0, 0.25, 0.25]
