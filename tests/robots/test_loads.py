"""Tests of the loads on wheels and casters, and of what a robot cannot do with them."""

import re
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.robots.check import fields
from applr_ros1.robots.geometry import GRAVITY, balance, supports

JACKAL = robots.JACKAL
BURGER = robots.load("turtlebot3_burger")
WAFFLE = robots.load("turtlebot3_waffle_pi")
# Casters of many round bases: two ahead of the axle and two behind it
FOUR_CASTERS = ((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))


def round_robot(com=(0.0, 0.0), casters=FOUR_CASTERS, mass=60.0, deceleration=1.5, **base):
    """Return a round robot of 0.5 m with two driven wheels on the axle.

    Args:
        com: Centre of mass of the body along x and y [m].
        casters: Contact points (x, y) of the casters [m].
        mass: Mass of the body [kg].
        deceleration: monitor.deceleration [m/s^2].
        **base: Other fields of the section base.
    """
    limits = {"max_acceleration": 1.5, "wheel_friction": 0.5, **base}
    return replace(
        BURGER,
        base=BURGER.base.model_copy(
            update={"track": 0.375, "wheel_mass": 2.0, "casters": casters, **limits}
        ),
        body=BURGER.body.model_copy(
            update={"size": (0.5, 0.5, 0.35), "mass": mass, "com": (*com, 0.2), "round": True}
        ),
        monitor=BURGER.monitor.model_copy(update={"deceleration": deceleration}),
        simulation=BURGER.simulation.model_copy(update={"grip_limit": 2.0}),
    )


def shares(robot):
    """Return each support's share of the weight, in the order of geometry.supports."""
    balanced = balance(robot)
    return balanced.loads / (balanced.mass * GRAVITY)


# -- loads
def test_driven_wheels_carry_the_robot_whose_mass_is_above_their_axle():
    assert shares(round_robot()) == pytest.approx([0.5, 0.5, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("side", "front", "rear"), [(1.0, 0.05, 0.0), (-1.0, 0.0, 0.05)])
def test_casters_on_the_side_to_which_the_robot_leans_carry_what_the_wheels_cannot(
    side, front, rear
):
    # Body and wheels have 64 kg: the common centre of mass is 0.02 m off the axle.
    leaning = round_robot(com=(side * 0.02 * 64 / 60, 0.0))
    assert shares(leaning) == pytest.approx([0.45, 0.45, front, front, rear, rear])


def test_casters_farther_from_the_axle_carry_more():
    near_and_far = ((-0.1, 0.1), (-0.1, -0.1), (-0.2, 0.0))
    *_, near_left, near_right, far = shares(round_robot((-0.03, 0.0), near_and_far))
    assert near_left == pytest.approx(near_right)
    assert far == pytest.approx(2 * near_left)


def test_loads_of_robots_with_three_supports_and_of_the_waffle_follow_from_equilibrium():
    burger_lever = 0.944 / 1.001 * 0.015 / 0.081
    assert shares(BURGER) == pytest.approx(
        [(1 - burger_lever) / 2, (1 - burger_lever) / 2, burger_lever]
    )
    waffle_lever = 1.484 / 1.541 * 0.015 / 0.177
    wheel_share = (1 - waffle_lever) / 2
    assert shares(WAFFLE) == pytest.approx(
        [wheel_share, wheel_share, waffle_lever / 2, waffle_lever / 2]
    )


def test_loads_balance_the_weight_and_nothing_pulls_if_the_mass_is_near_the_middle():
    random = np.random.default_rng(1)
    for _ in range(200):
        x, y = random.uniform((-0.04, -0.04), (0.04, 0.04))
        casters = []
        for side in (1.0, -1.0):
            for _ in range(random.integers(1, 4)):
                caster_x, caster_y = random.uniform((0.15, -0.15), (0.25, 0.15))
                casters.append((float(side * caster_x), float(caster_y)))
        robot = round_robot((float(x), float(y)), tuple(casters))
        mass, com, loads = balance(robot)
        contact_x, contact_y = supports(robot.base).T
        assert loads.sum() == pytest.approx(mass * GRAVITY)
        assert loads @ contact_x == pytest.approx(mass * GRAVITY * com[0])
        assert loads @ contact_y == pytest.approx(mass * GRAVITY * com[1])
        assert loads.min() >= 0.0


def test_loads_of_four_wheels_balance_a_mass_beside_the_middle():
    body = JACKAL.body.model_copy(update={"com": (0.03, -0.04, 0.1)})
    mass, com, loads = balance(replace(JACKAL, body=body))
    contact_x, contact_y = supports(JACKAL.base).T
    assert loads.sum() == pytest.approx(mass * GRAVITY)
    assert loads @ contact_x == pytest.approx(mass * GRAVITY * com[0])
    assert loads @ contact_y == pytest.approx(mass * GRAVITY * com[1])


def test_a_small_lean_to_the_side_lifts_no_caster():
    sideways = WAFFLE.body.model_copy(update={"com": (-0.015, 0.04, 0.05)})
    assert list(fields(replace(WAFFLE, body=sideways))) == []


@pytest.mark.parametrize("casters", [(), ((0.0, 0.2), (0.0, -0.2))])
def test_casters_must_stand_ahead_of_the_axle_or_behind_it(casters):
    (problem,) = fields(round_robot(casters=casters))
    assert problem.startswith("base.casters are missing: a two_wheel base has at least one ")


# -- what tyres cannot do
def test_an_acceleration_that_wheels_under_little_load_cannot_give_is_an_error():
    """The casters behind the axle carry most of the weight."""
    robot = round_robot(com=(-0.1279, 0.0), deceleration=0.5)
    (problem,) = fields(robot)
    assert problem == (
        "base.max_acceleration is 1.5: with simulation.grip_limit 2 and base.wheel_friction 0.5, "
        "driven wheels that carry 40 % of the weight give at most 0.8 m/s^2, and would slip: "
        "correct body.com or base.casters, or lower base.max_acceleration to 0.8"
    )
    slow_base = robot.base.model_copy(update={"max_acceleration": 0.8})
    assert list(fields(replace(robot, base=slow_base))) == []


def test_a_controller_may_allow_more_than_loaded_wheels_give():
    """Tyres cut such a limit at every hard start, as the Jackal's, and the robot drives."""
    assert list(fields(round_robot(max_acceleration=20.0))) == []


@pytest.mark.parametrize(
    ("com", "friction", "limit"),
    [
        ((0.0, 0.0), 0.5, 2.0),  # the friction limit
        ((0.0, 0.0), 0.1, 0.98),  # Coulomb friction of the wheels
        # 47 % of the weight on casters of friction 0.1
        ((-0.1, 0.0), 0.12, GRAVITY * (0.531 * 0.12 + 0.469 * 0.1)),
    ],
)
def test_a_deceleration_that_the_tyres_cannot_give_is_an_error(com, friction, limit):
    robot = round_robot(com, max_acceleration=2.5, deceleration=2.5, wheel_friction=friction)
    *_, problem = fields(robot)
    tyres = f"with simulation.grip_limit 2 and base.wheel_friction {friction:g}"
    assert problem.startswith(
        f"monitor.deceleration is 2.5: {tyres}, the base brakes with at most "
    )
    given_limit = float(re.search("at most (.*) m/s", problem)[1])
    assert given_limit == pytest.approx(limit, abs=0.002)
    braking = robot.monitor.model_copy(update={"deceleration": given_limit})
    for other_problem in fields(replace(robot, monitor=braking)):
        assert not other_problem.startswith("monitor.")
