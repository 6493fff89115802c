"""Tests of the Supervisor: when a decision is due, and what the planner has otherwise."""

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.parameter_space import SPACE, THETA_0, space_of
from applr_ros1.policy.pilot import BY_HAND, DEFAULTS, METHOD, STALL, Pilot
from applr_ros1.policy.supervisor import Supervisor
from applr_ros1.robots import JACKAL
from tests.support.contexts import Chooses, driving, parameters, scene

PERIOD = 1.0  # decision period in these tests [s]
FAST = parameters(max_vel_x=1.5)


class Supervised:
    """A supervisor, and the problems that it has reported."""

    def __init__(self, method=None, robot=JACKAL, period=PERIOD, **limits):
        self.troubles = []
        self.method = method or Chooses(FAST)
        self.method.name = "test"
        self.pilot = Pilot(self.method, robot, period, **limits)
        self.supervisor = Supervisor(self.pilot, seed=7, on_trouble=self.troubles.append)

    def begin(self, now=0.0, goal="one"):
        """Give a goal to the supervisor at rest."""
        self.supervisor.rest()
        assert self.supervisor.pursue(goal, now) is None

    def decide(self, now, context=None):
        """Decide, with the context of a robot that drives."""
        if context is None:
            context = driving(now)
        return self.supervisor.decide(now, context)

    def count(self, kind):
        """Return a counter."""
        return self.supervisor.counts[kind]


def speed(choice):
    """Return the largest speed [m/s] of a choice."""
    return SPACE.as_dict(choice.theta)["max_vel_x"]


DEFAULT_SPEED = SPACE.as_dict(THETA_0)["max_vel_x"]


# -- courses ---------------------------------------------------------------------------------------
def test_without_a_goal_nothing_is_due():
    supervised = Supervised()
    supervisor = supervised.supervisor
    assert not supervisor.is_due(10.0, is_settled=True)
    assert supervisor.activity == "idle: no goal"

    supervised.begin(10.0)
    assert supervisor.is_due(10.0, is_settled=True)
    assert supervisor.activity == "deciding"
    assert supervised.decide(10.0).number == 1

    # The goal ends.
    choice = supervisor.pursue(None, 11.5)
    assert (choice.why, speed(choice)) == (DEFAULTS, DEFAULT_SPEED)
    assert not supervisor.is_due(12.0, is_settled=True)
    assert supervisor.pursue(None, 13.0) is None
    assert supervisor.activity == "idle: no goal"


def test_each_course_has_a_seed_of_its_own_and_begins_with_a_decision_at_once():
    supervised = Supervised()
    supervised.begin(0.0, "one")
    supervised.decide(0.0)
    supervisor = supervised.supervisor
    assert not supervisor.is_due(0.5, is_settled=True)
    # Another goal replaces the first one.
    assert supervisor.pursue("two", 0.5) is None
    assert supervisor.is_due(0.5, is_settled=True)
    assert supervisor.began == 0.5
    assert supervisor.last is None
    # The same goal is no new course.
    supervisor.pursue("two", 0.6)
    assert supervised.method.seeds == [7, 8]


def test_the_first_decision_waits_a_period_at_most_for_the_parameters_before_the_course():
    supervised = Supervised()
    supervised.begin(5.0)
    supervisor = supervised.supervisor
    assert not supervisor.is_due(5.0, is_settled=False)
    assert not supervisor.is_due(5.95, is_settled=False)
    assert supervisor.is_due(5.5, is_settled=True)
    assert supervisor.is_due(6.0, is_settled=False)
    # Later decisions wait for nothing.
    supervised.decide(6.0)
    assert supervisor.is_due(7.0, is_settled=False)


def test_after_the_clock_jumped_back_the_course_is_forgotten():
    supervised = Supervised()
    supervised.begin(100.0)
    supervised.decide(100.0)
    choice = supervised.supervisor.forget_course()
    assert speed(choice) == DEFAULT_SPEED
    assert not supervised.supervisor.is_due(3.0, is_settled=True)
    assert supervised.supervisor.last is None
    # move_base still has the goal, which begins anew.
    supervised.supervisor.pursue("one", 3.0)
    assert supervised.supervisor.is_due(3.0, is_settled=True)


def test_a_method_that_cannot_be_reset_is_reported_and_drives():
    class Restless(Chooses):
        def reset(self, seed):
            raise RuntimeError("no map")

    supervised = Supervised(Restless(FAST))
    supervised.begin(0.0)
    (trouble,) = supervised.troubles
    assert "RuntimeError: no map" in trouble
    assert supervised.decide(0.0).request.why == METHOD


# -- when decisions are due ------------------------------------------------------------------------
def test_a_late_decision_is_counted_and_does_not_delay_the_next_one():
    supervised = Supervised()
    supervised.begin(0.0)
    # The first one waited for a plan: that is not late.
    supervised.decide(3.0)
    assert supervised.count("late") == 0
    assert supervised.supervisor.due == pytest.approx(4.0)
    supervised.decide(4.1)
    assert supervised.count("late") == 0
    assert supervised.supervisor.due == pytest.approx(5.0)
    supervised.decide(5.11)
    assert supervised.count("late") == 1
    assert supervised.supervisor.due == pytest.approx(6.0)
    # Two decisions are half a period apart at least.
    supervised.decide(6.9)
    assert supervised.supervisor.due == pytest.approx(7.4)
    assert supervised.count("decisions") == 4


@pytest.mark.parametrize(("period", "interval"), [(0.2, 0.2), (6.0, 2.0)])
def test_heartbeats_come_as_often_as_move_base_waits_for_them_however_rare_decisions_are(
    period, interval
):
    supervisor = Supervised(period=period).supervisor
    assert supervisor.is_beat_due(10.0)
    supervisor.beat(10.0)
    assert not supervisor.is_beat_due(10.0 + interval - 0.01)
    assert supervisor.is_beat_due(10.0 + interval)


def test_a_gap_in_the_heartbeats_is_reported_once():
    """move_base may have restored its start-up values in the meantime."""
    supervisor = Supervised(period=1.0).supervisor
    assert not supervisor.beat(10.0)
    assert not supervisor.beat(12.0)
    assert supervisor.beat(14.1)
    assert not supervisor.beat(15.1)

    # Time that the clock jumped back is no gap.
    supervisor.forget_course()
    assert supervisor.is_beat_due(3.0)
    assert not supervisor.beat(3.0)


# -- periods without a decision --------------------------------------------------------------------
def test_inputs_that_are_missing_count_after_a_whole_period():
    supervised = Supervised()
    supervised.begin(0.0)
    supervisor = supervised.supervisor
    assert supervisor.miss_inputs(0.9, "no plan") is None
    assert supervised.count("unusable") == 0
    requests = []
    for now in (1.0, 1.5, 2.0, 3.0, 4.0):
        requests.append(supervisor.miss_inputs(now, "no plan"))
    assert supervised.count("unusable") == 4
    # The defaults after the third one, once
    assert [request is not None for request in requests] == [False, False, False, True, False]
    assert requests[3].why == DEFAULTS
    assert supervisor.is_degraded
    assert supervised.troubles[-2:] == [
        "no decision for 3 periods: back to theta_0",
        "no plan",
    ]
    supervised.decide(4.5)
    assert not supervisor.is_degraded
    assert supervised.count("decisions") == 1


@pytest.mark.fault("1")
def test_a_decision_that_the_method_refuses_leaves_the_parameters():
    supervised = Supervised(Chooses(parameters(max_vel_x=np.inf)))
    supervised.begin(0.0)
    supervisor = supervised.supervisor
    ruling = supervised.decide(0.0)
    assert (ruling.theta, ruling.request, ruling.clears_costmaps) == (None, None, False)
    assert "max_vel_x is inf, not finite" in ruling.refused
    (trouble,) = supervised.troubles
    assert "decision refused, parameters unchanged" in trouble
    assert supervised.decide(1.0).request is None
    assert supervisor.in_force == "the parameters of method test"
    # After three of them the defaults
    assert supervised.decide(2.0).request.why == DEFAULTS
    assert supervisor.in_force == "the robot's default parameters"
    assert supervised.decide(3.0).request is None
    assert supervised.count("refused") == supervised.count("decisions") == 4
    # One that it makes ends the loss.
    supervised.method.chosen = FAST
    assert speed(supervised.decide(4.0).request) == 1.5
    assert supervisor.in_force == "the parameters of method test"


def test_any_error_of_a_users_method_is_a_refusal():
    supervised = Supervised(Chooses(AttributeError("theta")))
    supervised.begin(0.0)
    assert "AttributeError: theta" in supervised.decide(0.0).refused


# -- static methods --------------------------------------------------------------------------------
def test_a_static_methods_parameters_are_requested_between_courses_only():
    supervised = Supervised(Chooses(FAST, static=True))
    supervisor = supervised.supervisor
    choice = supervisor.rest()
    assert (choice.why, speed(choice)) == (METHOD, 1.5)
    assert supervisor.in_force == "the parameters of method test"
    supervisor.pursue("one", 0.0)
    # Other parameters may have been set by hand since.
    ruling = supervised.decide(0.0)
    assert ruling.request is None
    assert ruling.theta.tolist() == choice.theta.tolist()
    assert speed(supervisor.pursue(None, 1.0)) == 1.5


def test_after_a_stall_a_static_method_gets_its_parameters_back_once():
    supervised = Supervised(Chooses(FAST, static=True))
    supervised.begin(0.0)
    for now in (0.0, 1.0):
        assert supervised.decide(now, scene(now)).request is None
    ruling = supervised.decide(2.0, scene(2.0))
    assert (ruling.request.why, ruling.clears_costmaps) == (STALL, True)
    assert ruling.theta.tolist() == ruling.request.theta.tolist()
    assert not supervised.decide(3.0, scene(3.0)).clears_costmaps
    # The robot has come out.
    ruling = supervised.decide(4.0)
    assert (ruling.request.why, speed(ruling.request)) == (METHOD, 1.5)
    assert supervised.decide(5.0).request is None


def test_a_stall_that_ends_with_the_course_is_forgotten():
    supervised = Supervised(Chooses(FAST, static=True))
    supervised.begin(0.0)
    for now in (0.0, 1.0, 2.0):
        ruling = supervised.decide(now, scene(now))
    assert ruling.request.why == STALL
    assert speed(supervised.supervisor.pursue(None, 3.0)) == 1.5
    supervised.supervisor.pursue("two", 4.0)
    assert supervised.decide(4.0).request is None


def test_the_defaults_replace_a_static_method_that_raises():
    supervised = Supervised(Chooses(AttributeError("no context"), static=True))
    choice = supervised.supervisor.rest()
    assert (choice.why, speed(choice)) == (DEFAULTS, DEFAULT_SPEED)
    assert "AttributeError" in supervised.supervisor.degraded
    assert supervised.supervisor.is_degraded


# -- what people ask for ---------------------------------------------------------------------------
def test_switched_off_the_planner_has_the_defaults_and_on_again_the_course_goes_on():
    supervised = Supervised(Chooses(FAST, static=True))
    supervisor = supervised.supervisor
    assert not supervisor.has_rested
    supervised.begin(0.0)
    assert supervisor.has_rested

    supervisor.switch(False)
    assert not supervisor.has_rested
    assert supervisor.in_force == "the robot's default parameters"
    assert supervisor.activity == "switched off: the robot's default parameters drive now"
    assert speed(supervisor.rest()) == DEFAULT_SPEED

    supervisor.switch(True)
    assert not supervisor.has_rested
    assert speed(supervisor.rest()) == 1.5


def test_switched_on_once_more_a_method_drives_on():
    supervised = Supervised(Chooses(FAST, static=True))
    supervised.begin(0.0)
    in_force = supervised.supervisor.in_force
    supervised.supervisor.switch(True)
    assert supervised.supervisor.has_rested
    assert supervised.supervisor.in_force == in_force


def test_parameters_set_by_hand_stay_until_the_method_is_switched_on():
    supervised = Supervised(max_speed=1.6)
    supervised.begin(0.0)
    supervisor = supervised.supervisor
    theta = parameters(max_vel_x=1.2)

    # Capped and rounded; the others stay.
    choice = supervisor.set_by_hand({"max_vel_x": 9.0, "vx_samples": 6.4}, theta)
    expected = {**SPACE.as_dict(theta), "max_vel_x": 1.6, "vx_samples": 6}
    assert SPACE.as_dict(choice.theta) == expected
    assert choice.why == BY_HAND
    assert not supervisor.enabled
    assert supervisor.in_force == "the parameters set by hand"

    # A second change comes before the servers have answered to the first one.
    choice = supervisor.set_by_hand({"sim_time": 1.25}, theta)
    assert SPACE.as_dict(choice.theta) == {**expected, "sim_time": 1.25}
    # They stay after the end of the course.
    assert supervisor.pursue(None, 1.0).theta.tolist() == choice.theta.tolist()

    supervisor.switch(True)
    assert speed(supervisor.rest()) == DEFAULT_SPEED
    assert supervisor.in_force == "the robot's default parameters"


@pytest.mark.parametrize(
    ("values", "theta", "problem"),
    [
        ({"speed": 1.0}, THETA_0, "unknown parameter 'speed': use max_vel_x"),
        ({"max_vel_x": np.nan}, THETA_0, "max_vel_x is nan, not finite"),
        ({"max_vel_x": 1.0}, None, "parameters are not known yet"),
    ],
)
def test_refused_values_do_not_stop_the_method(values, theta, problem):
    supervised = Supervised()
    supervised.begin(0.0)
    with pytest.raises(ApplrError, match=problem):
        supervised.supervisor.set_by_hand(values, theta)
    assert supervised.supervisor.enabled
    assert supervised.supervisor.is_due(0.0, is_settled=True)


def test_a_new_method_decides_at_once_and_a_static_one_without_a_decision():
    supervised = Supervised()
    supervised.begin(0.0)
    supervised.decide(0.0)
    supervisor = supervised.supervisor
    supervisor.degraded = "no file"

    supervisor.change_method(Chooses(parameters(max_vel_x=0.9)), 0.3)
    assert supervisor.degraded == ""
    assert supervisor.is_due(0.3, is_settled=True)
    assert speed(supervised.decide(0.3).request) == 0.9

    assert supervisor.has_rested
    supervisor.change_method(Chooses(FAST, static=True), 0.5)
    assert not supervisor.is_due(0.5, is_settled=True)
    assert not supervisor.has_rested
    assert speed(supervisor.rest()) == 1.5

    # Without a goal
    supervisor.pursue(None, 1.0)
    supervisor.change_method(Chooses(FAST), 1.5)
    assert not supervisor.has_rested
    assert speed(supervisor.rest()) == DEFAULT_SPEED
    assert not supervisor.is_due(1.5, is_settled=True)


def test_each_costmap_has_its_own_default_between_courses_and_one_value_in_a_decision():
    """The files of this robot inflate the global costmap less than the local one."""
    inflation = {"global_costmap": {"inflater_layer": {"inflation_radius": 0.1}}}
    robot = JACKAL.with_parameters(inflation, "jackal with two inflations")
    space = space_of(robot)
    supervised = Supervised(Chooses(space.from_dict({"inflation_radius": 0.4})), robot)

    def radii(choice):
        settings = space.settings(choice.theta)
        layers = ("local_costmap/inflater_layer", "global_costmap/inflater_layer")
        return [settings[layer]["inflation_radius"] for layer in layers]

    assert radii(supervised.supervisor.rest()) == [0.3, 0.1]
    supervised.supervisor.pursue("one", 0.0)
    assert radii(supervised.decide(0.0).request) == [0.4, 0.4]
    supervised.supervisor.switch(False)
    assert radii(supervised.supervisor.rest()) == [0.3, 0.1]
