"""Tests of stalls: when a robot counts as stalled, and which parameters it then gets."""

from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.angles import transform_point
from applr_ros1.policy import methods
from applr_ros1.policy.decision import PERIOD
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.policy.methods import FixedParameters, Method
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.policy.stall_rule import BACKING_OUT, StallRule
from applr_ros1.policy.stuck import Stall, Stuck
from applr_ros1.robots import JACKAL, load
from tests.support.contexts import AHEAD, BACK, scene

SPACE = space_of(JACKAL)
SET = FixedParameters(SPACE.theta0)
SLOW = 0.106  # m/s: 0.848 m in 8 s, which is a stall
FAST = 0.107  # m/s: 0.856 m in 8 s
SLIPS = -0.01  # speed of a robot that stands and slips back [m/s]
BACKS = -0.03  # speed of a robot that backs out [m/s]
BACK_AND_FORTH = 0.5  # m/s: one metre ahead, and back
# Indices of the parameters that make TrajectoryPlannerROS back out, first the distance
BACKING = [SPACE.names.index(name) for name in ("escape_reset_dist", *BACKING_OUT)]
DISTANCE = BACKING[0]
MAX_VEL_X = SPACE.names.index("max_vel_x")


def place(time, speed):
    """Return x [m] of a robot that drives ahead at up to 0.11 m/s, or else 1 m ahead and back."""
    if speed < BACK_AND_FORTH:
        return speed * time
    return speed * min(time % 4, 4 - time % 4)


def course(
    seed=3,
    speed=SLOW,
    method=SET,
    robot=JACKAL,
    rule=None,
    backwards=(),
    ahead=(),
):
    """Return the parameters in place of the method's at 0, 1, ... 31 s, None where they stay.

    The robot measures a speed backwards at the times `backwards` [s], whatever its place: wheels
    that slip measure other speeds than the one at which it moves. Its plan leads ahead at the times
    `ahead`, and else back.
    """
    rule = rule or StallRule(robot)
    rule.begin_course(seed)
    theta = space_of(robot).theta0
    replaced = []
    for time in range(32):
        v = BACKS if time in backwards else SLIPS
        way = AHEAD if time in ahead else BACK
        context = scene(float(time), place(time, speed), v, robot, way)
        replaced.append(rule.redraw(method, context, theta))
    return replaced


def test_a_stalled_robot_gets_random_parameters_from_the_seed_of_the_course():
    # A stall is known after 8 s.
    standing = course()
    assert standing[:8] == [None] * 8
    assert course(speed=FAST) == [None] * 32
    drawn = np.array(standing[8:])

    # What no policy chooses stays as the method has it: min_in_place_vel_theta and the padding.
    for parameter_name in ("min_in_place_vel_theta", "footprint_padding"):
        index = SPACE.names.index(parameter_name)
        assert (drawn[:, index] == SPACE.theta0[index]).all()

    # The same seed gives the same parameters, with a new rule or the one of an earlier course.
    assert np.array_equal(course()[8:], drawn)
    rule = StallRule(JACKAL)
    for _ in range(2):
        repeated = course(rule=rule)
        assert repeated[:8] == [None] * 8
        assert np.array_equal(repeated[8:], drawn)
    assert np.array_equal(course(speed=BACK_AND_FORTH)[8:], drawn)

    # Another seed gives others.
    of_other_seed = np.array(course(seed=4)[8:])
    assert not np.isin(of_other_seed[:, MAX_VEL_X], drawn[:, MAX_VEL_X]).any()


def is_backing_out(theta):
    """Return whether parameters back out, which sets three of them together; None without any."""
    if theta is None:
        return None
    distance, rotation, sim_time = theta[BACKING]
    if distance == SPACE.theta0[DISTANCE]:
        return False
    assert 0.5 <= distance <= 1.0
    assert (rotation, sim_time) == (3.14, 3.0)
    return True


def test_a_method_with_the_same_seed_draws_others():
    encoding = DimensionlessEncoding(JACKAL, PERIOD)
    rng = np.random.default_rng(3)
    action = rng.uniform(-1.0, 1.0, encoding.actions)
    theta = encoding.theta(action)
    drawn = course(seed=3)[8]
    assert drawn[MAX_VEL_X] != theta[MAX_VEL_X]


def test_the_distance_backwards_is_between_half_a_metre_and_one():
    distances = [course(seed)[8][DISTANCE] for seed in range(100)]
    assert 0.5 <= min(distances) < 0.52
    assert 0.98 < max(distances) <= 1.0


def test_parameters_are_drawn_on_both_sides_of_the_middle():
    encoding = DimensionlessEncoding(JACKAL, PERIOD)
    middle_theta = encoding.theta(np.zeros(encoding.actions))
    speeds = [course(seed)[8][MAX_VEL_X] for seed in range(20)]
    assert min(speeds) < middle_theta[MAX_VEL_X] < max(speeds)


def phases(replaced):
    """Return (whether the robot backs out, number of decisions) of each phase from 8 s on."""
    kinds = []
    decision_counts = []
    phase_theta = np.empty(0)
    for theta in replaced[8:]:
        backs_out = is_backing_out(theta)
        # A phase keeps its parameters, and the next one draws others.
        if not np.array_equal(phase_theta, theta):
            kinds.append(backs_out)
            decision_counts.append(0)
            phase_theta = theta
        decision_counts[-1] += 1
    return list(zip(kinds, decision_counts))


def test_a_stalled_robot_backs_out_and_drives_by_turns_with_other_parameters_each_time():
    # Standing, it tries to back out for 8 s, and drives for 3 s.
    assert phases(course()) == [
        (True, 8),
        (False, 3),
        (True, 8),
        (False, 3),
        (True, 2),
    ]
    # It drives back from 10 to 12 s, and at 17 s.
    replaced = course(backwards=(10, 11, 12, 17))
    assert phases(replaced) == [
        (True, 5),
        (False, 3),
        (True, 2),
        (False, 3),
        (True, 8),
        (False, 3),
    ]
    # Each of the three times, it backs out by another distance.
    distances = {theta[DISTANCE] for theta in replaced[8:] if is_backing_out(theta)}
    assert len(distances) == 3


def test_where_the_plan_leads_ahead_random_parameters_and_the_methods_alternate():
    replaced = course(ahead=range(32))
    assert phases(replaced) == [(False, 3), (None, 3)] * 4


def test_a_robot_that_has_turned_gets_its_method_and_backs_out_where_the_plan_turns_back():
    replaced = course(ahead=range(11, 18))
    assert phases(replaced)[:5] == [
        (True, 3),
        (None, 3),
        (False, 3),
        (None, 1),
        (True, 8),
    ]


def backs_out(pose, points):
    """Return whether a stalled robot backs out with a plan through points (n, 2) ahead and left."""
    forward, leftward = np.transpose(points)
    plan = np.column_stack(transform_point(pose, forward, leftward))
    rule = StallRule(JACKAL)
    for time in range(9):
        context = replace(scene(float(time)), pose=pose, plan=plan)
        theta = rule.redraw(SET, context, SPACE.theta0)
    return is_backing_out(theta)


@pytest.mark.parametrize("yaw", [0.0, 2.0, -2.5])
def test_the_plan_leads_back_if_it_begins_in_the_half_plane_behind_the_robot(yaw):
    distances = np.linspace(0.0, 2.0, 40)
    for angle in (0.0, 1.4, -1.4, 1.75, -1.75, 3.0):
        direction = (np.cos(angle), np.sin(angle))
        straight_plan = np.outer(distances, direction)
        assert backs_out((30.0, -20.0, yaw), straight_plan) == (abs(angle) > 1.5)


def test_the_first_third_of_a_metre_of_the_plan_counts():
    for turn_back, leads_back in ((-0.28, False), (-0.33, True)):
        there_and_ahead = [
            *np.arange(0.0, turn_back, -0.01),
            *np.arange(turn_back, 3.0, 0.01),
        ]
        points = np.column_stack([there_and_ahead, np.zeros(len(there_and_ahead))])
        assert backs_out((0.0, 0.0, 0.0), points) == leads_back


def test_a_robot_without_a_plan_does_not_stand_in_a_dead_end():
    """It goes on backing out, for which it has up to 8 s, although it has not moved yet."""
    rule = StallRule(JACKAL)
    chosen = []
    for time in range(8 + 8):
        context = replace(scene(float(time)), plan=np.zeros((0, 2)))
        chosen.append(rule.redraw(SET, context, SPACE.theta0))
    assert all(map(is_backing_out, chosen[8:]))


@pytest.mark.parametrize(("speed", "stands"), [(0.0, True), (SLOW, False)])
def test_where_the_robot_stands_its_own_padding_and_inflation_let_a_plan_out(speed, stands):
    padding, inflation = map(SPACE.names.index, ("footprint_padding", "inflation_radius"))
    theta = SPACE.theta0.copy()
    theta[padding] = 0.14
    rule = StallRule(JACKAL)
    rule.begin_course(3)
    for time in range(12):
        replaced = rule.redraw(SET, scene(float(time), place(time, speed)), theta)
    assert (replaced[padding] == SPACE.theta0[padding]) == stands
    assert (replaced[inflation] == SPACE.theta0[inflation]) == stands


def test_a_robot_that_stands_within_the_tolerance_of_its_goal_is_not_stuck():
    def last_decision(distance):
        rule = StallRule(JACKAL)
        for time in range(9):
            goal = (0.0, distance, 1.0)
            context = replace(scene(float(time)), goal=goal, plan=np.zeros((0, 2)))
            replaced = rule.redraw(SET, context, SPACE.theta0)
        return replaced, rule.clears_costmaps

    assert last_decision(JACKAL.goal_tolerance - 0.01) == (None, False)
    beyond_tolerance, clears_costmaps = last_decision(JACKAL.goal_tolerance + 0.01)
    assert beyond_tolerance is not None
    assert clears_costmaps


def test_each_stall_begins_with_backing_out():
    rule = StallRule(JACKAL)
    # From 16 s on, it would drive.
    for time in range(17):
        rule.redraw(SET, scene(float(time)), SPACE.theta0)
    assert rule.redraw(SET, scene(17.0, v=0.5), SPACE.theta0) is None
    assert is_backing_out(rule.redraw(SET, scene(18.0), SPACE.theta0))


def test_the_costmaps_are_cleared_at_the_beginning_of_each_stall_and_every_8_seconds():
    """The first stall is from 8 to 25 s, and the next one begins at 30 s.

    The robot creeps, so that only its displacement in 8 s tells.
    """
    for method, clearing_times in (
        (SET, [8, 16, 24, 30]),
        (methods.make("dwa"), []),
    ):
        rule = StallRule(JACKAL)
        times = []
        for time in range(32):
            v = 0.5 if 26 <= time < 30 else 0.0
            context = scene(float(time), place(time, SLOW), v)
            rule.redraw(method, context, SPACE.theta0)
            if rule.clears_costmaps:
                times.append(time)
        assert times == clearing_times


def test_a_robot_that_has_just_come_out_has_not_stalled():
    """It passes near its place 8 s ago, but so fast ahead that it is soon away."""
    # OUT_TIME_S is 2 s: 0.425 m/s would take it 0.85 m.
    for v, count in (
        (0.4, 1),
        (0.45, 0),
        (-0.45, 1),
    ):
        rule = StallRule(JACKAL)
        for time in range(8):
            rule.redraw(SET, scene(float(time), place(time, SLOW)), SPACE.theta0)
        rule.redraw(SET, scene(8.0, place(8, SLOW), v), SPACE.theta0)
        assert rule.count == count


def test_times_that_are_sums_of_periods_count_as_reached():
    """Ten sums of 0.1 s are less than 1 s."""
    rule = StallRule(JACKAL)
    time = 0.0
    replaced = []
    clearing_decisions = []
    for decision in range(200):
        replaced.append(rule.redraw(SET, scene(time, place(time, SLOW)), SPACE.theta0))
        if rule.clears_costmaps:
            clearing_decisions.append(decision)
        time += 0.1
    assert [theta is None for theta in replaced] == [True] * 80 + [False] * 120
    assert phases(replaced[72:]) == [(True, 80), (False, 30), (True, 10)]
    assert clearing_decisions == [80, 160]


def test_distance_and_speed_of_a_stall_scale_with_the_robot():
    """For the Jackal, 1.6 m in 8 s or 0.8 m/s are enough, but not for a robot of twice its size."""
    for scale, stalled in ((1.0, False), (2.0, True)):
        stall = Stall(scale)
        for second in range(9):
            is_stalled = stall.add_position(float(second), 0.2 * second, 0.0, 0.0)
        assert is_stalled is stalled
        assert stall.add_position(9.0, 1.6, 0.0, 0.8) is stalled
        # It is 1.4 m away from its place 8 s ago, of 1.7 m that the large robot needs.
        expected_share = pytest.approx(1.4 / 1.7) if stalled else 1.0
        assert stall.share == expected_share


def test_a_robot_whose_planner_cannot_back_out_gets_random_parameters_only():
    burger = load("turtlebot3_burger")
    replaced = course(robot=burger, speed=0.01)
    assert np.array(replaced[8:]).shape == (24, len(space_of(burger)))


def test_a_small_robot_stalls_at_a_smaller_speed():
    """At 0.07 m/s a Jackal stalls, but not a burger, whose `world_scale` is 0.43."""
    burger = load("turtlebot3_burger")
    assert course(robot=burger, speed=0.07) == [None] * 32
    assert course(robot=JACKAL, speed=0.07)[8] is not None


def test_every_method_gets_them_that_does_not_refuse():
    class Own(Method):
        pass

    assert course(method=Own())[8] is not None
    refusing = {"dwa", "random", "explore", "appld"}
    for method_name in methods.METHODS:
        method = methods.make(method_name)
        rule = StallRule(JACKAL)
        replaced = course(method=method, rule=rule)
        is_refusing = method_name in refusing
        assert all(theta is None for theta in replaced) == is_refusing, method_name
        assert rule.count == (0 if is_refusing else 24)


# -- dead ends that are clear before 8 s
def first_change(poses, ways, period=1.0, robot=JACKAL):
    """Return the time of the first changed decision [s], None if there is none.

    Args:
        poses: (x, y, yaw) at each decision.
        ways: Direction of the plan at each decision: BACK or AHEAD.
        period: Decision period [s].
        robot: Description of the robot.
    """
    rule = StallRule(robot)
    theta = space_of(robot).theta0
    for decision, (pose, way) in enumerate(zip(poses, ways)):
        context = scene(decision * period, robot=robot)
        forward = np.linspace(0.0, 3.0, 60)
        plan = transform_point(pose, way * forward, np.zeros(60))
        context = replace(context, pose=pose, plan=np.column_stack(plan))
        if rule.redraw(SET, context, theta) is not None:
            return decision * period
    return None


def creeping(speed, count=8):
    """Return the poses of a robot that drives ahead at a speed [m] per decision."""
    return [(speed * decision, 0.0, 0.0) for decision in range(count)]


def turning(angle, count=8):
    """Return the poses of a robot that turns by an angle [rad] per decision."""
    return [(0.0, 0.0, angle * decision) for decision in range(count)]


def test_a_robot_that_gets_nowhere_with_a_plan_that_leads_back_is_in_a_dead_end():
    """It is so if it moves by less than 0.2 m and turns by less than 0.5 rad in 2 decisions."""
    back = [BACK] * 8
    assert first_change(creeping(0.09), back) == 2.0
    assert first_change(creeping(0.11), back) is None
    assert first_change(turning(0.24), back) == 2.0
    assert first_change(turning(0.26), back) is None
    assert first_change(turning(-0.26), back) is None
    # A plan that leads ahead in between, and a robot of twice the size or half of it
    assert first_change(creeping(0.09), [BACK, BACK, AHEAD] + [BACK] * 5) == 5.0
    burger = load("turtlebot3_burger")
    assert first_change(creeping(0.06), back, robot=burger) is None
    assert first_change(creeping(0.06), back) == 2.0


def test_a_dead_end_is_clear_after_two_seconds_whatever_the_period():
    for period in (0.1, 0.5, 1.0, 2.0):
        poses = creeping(0.0, count=40)
        for way in (BACK, AHEAD):
            assert first_change(poses, [way] * 40, period) == pytest.approx(2.0)


def test_a_robot_that_stands_for_two_seconds_is_in_a_dead_end_whatever_its_plan():
    ahead = [AHEAD] * 8
    assert first_change(creeping(0.02), ahead) == 2.0
    assert first_change(creeping(0.03), ahead) is None
    assert first_change(creeping(0.02), ahead, robot=load("turtlebot3_burger")) is None
    assert first_change(turning(0.04), ahead) == 2.0
    assert first_change(turning(0.06), ahead) is None
    # The yaw passes pi.
    yaws = (3.13, -3.13, 3.13, -3.13)
    assert first_change([(0.0, 0.0, yaw) for yaw in yaws], ahead) == 2.0


def test_without_a_plan_or_near_its_end_no_dead_end_is_clear():
    for plan_length in (0, 5, 6):
        rule = StallRule(JACKAL)
        thetas = []
        for time in range(9):
            # The points are 5 cm apart.
            context = scene(float(time))
            context = replace(context, plan=context.plan[: plan_length + 1])
            if not plan_length:
                context = replace(context, plan=np.zeros((0, 2)))
            thetas.append(rule.redraw(SET, context, SPACE.theta0))
        is_long_enough = plan_length == 6
        assert (thetas[7] is not None) == is_long_enough
        assert thetas[8] is not None


def test_a_stall_in_a_dead_end_lasts_until_the_robot_has_left_the_place():
    for x, v, is_changed in (
        (-0.8, -0.5, True),
        (-0.9, -0.5, False),
        (0.0, 0.45, False),
    ):
        rule = StallRule(JACKAL)
        for time in range(3):
            rule.redraw(SET, scene(float(time)), SPACE.theta0)
        theta = rule.redraw(SET, scene(3.0, x, v), SPACE.theta0)
        assert (theta is not None) == is_changed, (x, v)


def test_a_place_that_the_robot_has_left_is_forgotten():
    stuck = Stuck(scale=1.0)
    for time in range(3):
        is_stuck = stuck.add_decision(float(time), (0.0, 0.0, 0.0), 0.0, leads_back=True)
    assert is_stuck
    assert not stuck.add_decision(3.0, (-0.9, 0.0, 0.0), -0.5, leads_back=True)
    assert not stuck.add_decision(4.0, (-0.2, 0.0, 0.0), 0.2, leads_back=True), (
        "it passes there again"
    )


def test_a_robot_that_is_held_while_it_backs_out_drives_instead():
    rule = StallRule(JACKAL)
    backing_out = []
    for time in range(9):
        theta = rule.redraw(SET, scene(float(time)), SPACE.theta0)
        backing_out.append(is_backing_out(theta))
    # The dead end is known at 2 s, and at 4 s the robot has not backed out.
    assert backing_out == [None, None, True, True, False, False, False, True, True]
