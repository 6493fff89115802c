"""Tests of the Pilot: method, stall rule, fallback and speed limit."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.methods import FixedParameters
from applr_ros1.policy.observation import LAYOUT
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.policy.pilot import DEFAULTS, METHOD, STALL, Pilot
from applr_ros1.policy.stall_rule import BACKING_OUT
from applr_ros1.robots import JACKAL
from tests.support.contexts import Chooses, driving, parameters, scene

SPACE = space_of(JACKAL)
THETA_0 = SPACE.theta0
NAMES = ("husky", "jackal", "turtlebot3_burger", "turtlebot3_waffle_pi")


def stalled(pilot, seconds=3, robot=JACKAL):
    """Return the choice in a dead end that is clear after 2 s."""
    for time in range(seconds):
        choice = pilot.decide(scene(float(time), robot=robot))
    return choice


# -- the method's parameters -----------------------------------------------------------------------
def test_parameters_of_the_method_are_clipped_and_counts_rounded():
    method = Chooses(parameters(max_vel_x=9.0, vx_samples=6.6, sim_time=-1.0))
    choice = Pilot(method, JACKAL).decide(driving(0))
    shortest = SPACE.low[SPACE.names.index("sim_time")]
    expected = {"max_vel_x": 2.0, "vx_samples": 7, "sim_time": shortest}
    assert SPACE.as_dict(choice.theta) == {**SPACE.as_dict(THETA_0), **expected}
    assert (choice.clears_costmaps, choice.why) == (False, METHOD)


def test_a_method_that_chooses_the_default_parameters_leaves_the_planners_unit():
    assert Pilot(Chooses(), JACKAL).decide(driving(0)).why == DEFAULTS


def test_observations_are_scaled_to_the_whole_ranges_whatever_the_speed_limit():
    seen = Seen(
        scan=(np.ones(720, np.float32), LAYOUT.angle_min, LAYOUT.step),
        time=0.0,
        pose=(0.0, 0.0, 0.0),
        twist=(0.0, 0.0),
        goal=(1.0, 0.0, 0.0),
        plan=np.zeros((0, 2)),
        movers=np.zeros((0, 4)),
    )
    fast = Pilot(Chooses(), JACKAL).observe(THETA_0, seen)
    slow = Pilot(Chooses(), JACKAL, max_speed=0.3).observe(THETA_0, seen)
    assert np.array_equal(fast.observation, slow.observation)


# -- in a stall ------------------------------------------------------------------------------------
def test_the_stall_rule_takes_the_place_of_the_method():
    # Given: a robot in a dead end
    pilot = Pilot(Chooses(parameters(max_vel_x=1.0)), JACKAL)
    pilot.begin(3)
    first_choice = pilot.decide(scene(0.0))
    assert first_choice.why == METHOD

    # When: the dead end is clear
    pilot.decide(scene(1.0))
    choice = pilot.decide(scene(2.0))

    # Then: the costmaps are cleared once
    assert (choice.why, choice.clears_costmaps) == (STALL, True)
    assert not np.array_equal(choice.theta, THETA_0)
    next_choice = pilot.decide(scene(3.0))
    assert (next_choice.why, next_choice.clears_costmaps) == (STALL, False)
    assert pilot.stall_rule.count == 2
    assert pilot.decide(driving(60)).why == METHOD
    assert pilot.stall_rule.count == 2


@pytest.mark.parametrize("max_speed", [2.0, 0.6, 0.3])
def test_parameters_in_a_stall_are_within_the_ranges_and_the_speed_limit(max_speed):
    pilot = Pilot(Chooses(), JACKAL, max_speed=max_speed)
    for seed in range(20):
        pilot.begin(seed)
        for time in range(30):
            choice = pilot.decide(scene(float(time)))
            theta = choice.theta
            assert np.array_equal(SPACE.below(max_speed).clip(theta), theta)
            values = SPACE.as_dict(theta)
            assert values["min_vel_x"] <= values["max_vel_x"]
    assert choice.why == STALL


def test_a_robot_that_backs_out_has_no_slow_way_ahead():
    """At 0.1 m/s a way ahead is nearly always free. The smallest speed is below the largest."""
    pilot = Pilot(Chooses(), JACKAL)
    speeds = set()
    for seed in range(20):
        pilot.begin(seed)
        values = SPACE.as_dict(stalled(pilot).theta)
        assert values["sim_time"] == BACKING_OUT["sim_time"]
        assert values["min_vel_x"] == min(0.5, values["max_vel_x"])
        speeds.add(values["min_vel_x"])
        # Otherwise it is that of the method.
        driving_values = SPACE.as_dict(stalled(pilot, seconds=6).theta)
        assert driving_values["escape_reset_dist"] == SPACE.as_dict(THETA_0)["escape_reset_dist"]
        assert driving_values["min_vel_x"] == SPACE.as_dict(THETA_0)["min_vel_x"]
    assert len(speeds) > 1


@pytest.mark.parametrize(("speeds", "smallest"), [((2.5, 3.0), 0.5), ((0.1, 0.15), 0.15)])
def test_its_smallest_speed_is_at_most_a_largest_one_that_no_policy_chooses(speeds, smallest):
    # Given: a robot whose range of the largest speed [m/s] is none of a policy's outputs
    described = []
    for parameter in JACKAL.space:
        if parameter.name == "max_vel_x":
            parameter = parameter.model_copy(update={"range": speeds})
        described.append(parameter)
    top_speed = {"TrajectoryPlannerROS": {"max_vel_x": speeds[1]}}
    jackal = JACKAL.with_parameters(top_speed, f"jackal with {speeds}")
    robot = replace(jackal, space=tuple(described))
    space = space_of(robot)

    # When: it is in a dead end
    choice = stalled(Pilot(FixedParameters(space.theta0, space), robot), robot=robot)

    # Then
    values = space.as_dict(choice.theta)
    assert (values["min_vel_x"], values["max_vel_x"]) == pytest.approx((smallest, speeds[1]))


# -- courses ---------------------------------------------------------------------------------------
def test_each_course_begins_anew_although_the_method_raises():
    class Restless(Chooses):
        def reset(self, seed):
            raise RuntimeError("no map")

    pilot = Pilot(Restless(parameters(max_vel_x=1.0)), JACKAL)
    stalled(pilot)
    pilot.miss()
    with pytest.raises(RuntimeError, match="no map"):
        pilot.begin(0)
    assert pilot.misses == 0
    assert pilot.decide(scene(0.0)).why == METHOD


def test_method_and_stall_rule_draw_from_the_seed_of_the_course():
    method = Chooses()
    pilot = Pilot(method, JACKAL)
    thetas = []
    for seed in (5, 6, 5):
        pilot.begin(seed)
        thetas.append(stalled(pilot).theta.tolist())
    assert method.seeds == [5, 6, 5]
    assert thetas[0] == thetas[2] != thetas[1]


def test_the_period_is_that_of_the_pilot_or_else_of_the_method():
    method = Chooses()
    method.period = 0.7
    assert Pilot(method, JACKAL).period == 0.7
    pilot = Pilot(method, JACKAL, period=0.5)
    assert pilot.period == 0.5
    # A policy's observation depends on it.
    pilot.begin(0)
    assert method.period == 0.5


# -- without a decision ----------------------------------------------------------------------------
def test_after_three_periods_without_a_decision_come_the_defaults():
    pilot = Pilot(Chooses(parameters(max_vel_x=1.5)), JACKAL, max_speed=0.4)
    for _ in range(2):
        # The parameters stay for two periods.
        assert [pilot.miss(), pilot.miss()] == [None, None]
        assert not pilot.has_lost_method
        choice = pilot.miss()
        assert choice.why == DEFAULTS
        assert SPACE.as_dict(choice.theta) == {**SPACE.as_dict(THETA_0), "max_vel_x": 0.4}
        # Requested once
        assert pilot.miss() is None
        assert pilot.has_lost_method
        # A decision ends the loss.
        pilot.decide(driving(0))
        assert not pilot.has_lost_method


def test_a_static_method_keeps_its_parameters_without_a_decision():
    pilot = Pilot(Chooses(static=True), JACKAL)
    assert [pilot.miss() for _ in range(5)] == [None] * 5
    assert pilot.has_lost_method


def test_between_courses_the_planner_has_a_static_methods_parameters_or_the_defaults():
    fast = parameters(max_vel_x=9.0)
    static_choice = Pilot(Chooses(fast, static=True), JACKAL, max_speed=1.5).between_courses()
    assert SPACE.as_dict(static_choice.theta) == {**SPACE.as_dict(THETA_0), "max_vel_x": 1.5}
    assert static_choice.why == METHOD
    choice = Pilot(Chooses(fast), JACKAL).between_courses()
    assert choice.theta.tolist() == THETA_0.tolist()
    assert choice.why == DEFAULTS
    with pytest.raises(ApplrError, match="no set"):
        Pilot(Chooses(ApplrError("no set"), static=True), JACKAL).between_courses()
