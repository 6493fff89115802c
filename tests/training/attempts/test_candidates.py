"""Tests of what else could be set in a robot."""

from itertools import chain
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.obstacle_range import laser_sources
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, load
from training.attempts.candidates import (
    Candidate,
    advice_of,
    candidates_of,
    with_changes,
)
from training.attempts.usual_values import UsualValues, places_of
from training.why import remedies

BURGER = load("turtlebot3_burger")
HUSKY = load("husky")
COSTMAPS = ("local_costmap", "global_costmap")
INFLATION_LAYERS = ("local_costmap/inflation_layer", "global_costmap/inflation_layer")


def all_candidates(robot):
    """Return the whole list of a robot."""
    return [*chain(*candidates_of(robot))]


def advice_in_order(robot):
    """Return the whole list of a robot as instructions."""
    return [advice_of(robot, candidate) for candidate in all_candidates(robot)]


def planner_of_burger(**values):
    """Return a Burger with other values of its local planner."""
    return BURGER.with_parameters({"DWAPlannerROS": values}, f"burger of {values}")


def test_a_change_counts_in_all_places_and_keeps_to_the_range():
    space = space_of(BURGER)
    changed_robots = {}
    for candidate in all_candidates(BURGER):
        robot = with_changes(BURGER, candidate.changes, f"burger with {candidate}")
        changed_robots[candidate.changes[0].advice] = robot
        theta = space_of(robot).theta0
        changed_entries = np.flatnonzero(theta != space.theta0)
        changed_names = [space.names[index] for index in changed_entries]
        # A parameter outside the policy's space changes nothing of it.
        assert changed_names == [name for name in candidate.names if name in space.names]
        assert (space.low <= theta).all()
        assert (theta <= space.high).all()

    # DWAPlannerROS limits the speed in two places, of which the lower one counts.
    slow_robot = changed_robots["set DWAPlannerROS/max_vel_trans to 0.11 instead of 0.22"]
    planner_values = slow_robot.parameters()["DWAPlannerROS"]
    assert planner_values["max_vel_x"] == 0.11
    assert planner_values["max_vel_trans"] == 0.11


@pytest.mark.parametrize(
    ("name", "value", "advice"),
    [
        ("occdist_scale", 20.0, "0.02 instead of 20"),
        ("forward_point_distance", 3.0, "0.325 instead of 3"),
        ("acc_lim_theta", 0.1, "3.2 instead of 0.1"),
        # The base accelerates at 1 m/s^2.
        ("acc_lim_x", 0.1, "1 instead of 0.1"),
        ("sim_time", 0.0, "1.7 instead of 0"),
        # It has no value of another robot.
        ("yaw_goal_tolerance", 0.0, "0.2 instead of 0"),
        ("vth_samples", 2, "20 instead of 2"),
        # It is no parameter of the robot's space.
        ("scaling_speed", 40.0, "0.25 instead of 40"),
    ],
)
def test_the_usual_value_of_an_unusual_parameter_is_tried_first(name, value, advice):
    first, *_ = advice_in_order(planner_of_burger(**{name: value}))
    assert first.startswith(f"set DWAPlannerROS/{name} to {advice}")


def test_the_most_unusual_of_two_values_is_tried_first():
    # Four times a usual speed, and twenty times a usual share that is declared after it
    robot = planner_of_burger(scaling_speed=1.0, max_scaling_factor=4.0)
    first, second, *_ = all_candidates(robot)
    assert [*first.names, *second.names] == ["max_scaling_factor", "scaling_speed"]


@pytest.mark.parametrize(
    ("name", "spoilt", "usual"),
    [
        ("path_distance_bias", 0.01, 32.0),
        # Where 20 is usual, a factor of 2 does not lead to it.
        ("goal_distance_bias", 0.5, 20.0),
        # A Husky has 0.6, but with a goal weight of 0.8.
        ("path_distance_bias", 0.5, 32.0),
    ],
)
def test_biases_are_as_unusual_as_their_ratio_and_tried_as_robots_have_them(name, spoilt, usual):
    robot = planner_of_burger(**{name: spoilt})
    as_husky, as_before, *_ = candidates_of(robot).unusual
    assert {(server_name, value) for _, server_name, value in as_husky.new_values} == {
        ("path_distance_bias", 0.6),
        ("goal_distance_bias", 0.8),
    }
    (change,) = as_before.changes
    assert (change.name, change.after) == (name, usual)


def test_values_of_a_usual_robot_are_tried_after_the_changes_that_free_most_robots():
    in_order = advice_in_order(HUSKY)
    both_weights, least_fear = in_order[:2]
    assert both_weights == (
        "set DWAPlannerROS/path_distance_bias to 32 instead of 0.6 "
        "and set DWAPlannerROS/goal_distance_bias to 20 instead of 0.8"
    )
    assert least_fear == "set DWAPlannerROS/occdist_scale to 0.005 instead of 0.01"
    other_weight = in_order.index("set DWAPlannerROS/path_distance_bias to 32 instead of 0.6")
    assert other_weight > in_order.index("set DWAPlannerROS/vx_samples to 6 instead of 3")


def test_the_largest_speed_of_the_base_is_usual():
    """No other robot of this planner turns so fast, and none drives faster than its base."""
    robot = planner_of_burger(max_vel_theta=BURGER.base.max_yaw_rate)
    usual_values = UsualValues(robot)
    (turn_rate,) = [place for place in places_of(robot) if place.name == "max_vel_theta"]
    assert usual_values.departure(turn_rate) == 0.0
    speeds = [place for place in places_of(robot) if place.name in ("max_vel_x", "max_vel_trans")]
    for place in speeds:
        # The default is 0.55 m/s. The Husky's files give half of what its base can drive.
        largest_speed = BURGER.base.max_speed
        assert usual_values.to_try(place) == [largest_speed, largest_speed / 2]


def test_a_radius_changes_in_both_costmaps_if_they_share_it():
    """The burger's files give it to the costmaps, whose values its layers take."""

    def advice_with(radius_of_local):
        costmaps = {
            "local_costmap": {"inflation_radius": radius_of_local},
            "global_costmap": {"inflation_radius": 9.0},
        }
        robot = BURGER.with_parameters(costmaps, f"burger of radii 9 and {radius_of_local}")
        return advice_in_order(robot)[0]

    of_global = "set global_costmap/inflation_radius to 1 instead of 9"
    of_local = "set local_costmap/inflation_radius to 1 instead of 9"
    assert advice_with(9.0) == f"{of_local} and {of_global}"
    assert advice_with(1.0) == of_global


def test_limits_of_a_turn_keep_their_signs():
    slow_turn = {"TrajectoryPlannerROS": {"max_vel_theta": 0.01, "min_vel_theta": -0.01}}
    robot = JACKAL.with_parameters(slow_turn, "jackal that hardly turns")
    assert advice_in_order(robot)[0] == (
        "set TrajectoryPlannerROS/max_vel_theta to 1 instead of 0.01 "
        "and set TrajectoryPlannerROS/min_vel_theta to -1 instead of -0.01"
    )


def test_a_value_under_an_older_name_is_named_and_replaced_by_the_latest():
    heavy_weight = {"TrajectoryPlannerROS": {"path_distance_bias": None, "pdist_scale": 5.0}}
    robot = JACKAL.with_parameters(heavy_weight, "jackal that keeps to its path")
    first, *_ = all_candidates(robot)
    advice = "set TrajectoryPlannerROS/path_distance_bias to 0.6 instead of 5"
    assert advice_of(robot, first) == advice
    mended = with_changes(robot, first.changes, "mended")
    assert mended.all_parameters()["TrajectoryPlannerROS"]["pdist_scale"] == 0.6


@pytest.mark.parametrize("robot", [BURGER, JACKAL, HUSKY], ids=lambda robot: robot.name)
def test_no_change_is_tried_twice(robot):
    candidates = all_candidates(robot)
    assert len(set(candidates)) == len(candidates) > 20


# -- what a recorded drive is tried with
@pytest.mark.parametrize("most", [remedies.CANDIDATES, 4])
def test_why_drives_a_part_of_the_list_that_check_drives_in_its_order(most, monkeypatch):
    monkeypatch.setattr(remedies, "CANDIDATES", most)
    robot = planner_of_burger(goal_distance_bias=0.5, sim_time=0.1)
    unusual, others = candidates_of(robot)
    # An unusual value is replaced by usual ones alone, so that what helps names the cause.
    assert not any("sim_time" in candidate.names for candidate in others)
    guesses = []
    for candidate in (others[9], others[3], others[5]):
        # The replay knows other values before the changes.
        changes = [change._replace(before=7.0) for change in candidate.changes]
        guesses.append(SimpleNamespace(changes=changes))
    chosen = remedies.candidates(robot, guesses, policy_decides=False)
    # Many unusual values leave room for what the replay ranks.
    assert chosen == [*unusual[: most - 3], others[3], others[5], others[9]]


def test_why_gives_the_robot_no_more_speed_than_its_owner_wants():
    """A drive that is judged by its time would be better."""
    slow = planner_of_burger(max_vel_x=0.05, max_vel_trans=0.05, min_vel_trans=0.02)
    speeds = ["max_vel_trans", "max_vel_x"]
    assert speeds in [candidate.names for candidate in candidates_of(slow).unusual]
    for candidate in chain(*remedies.possible_candidates(slow, policy_decides=False)):
        for change in candidate.changes:
            assert change.name not in speeds or change.after < change.before


# -- values of files
def test_a_slowest_speed_above_the_fastest_one_is_lowered_below_it():
    crossed = Change("DWAPlannerROS", "max_vel_trans", 0.22, 0.08)
    lowered = Change("DWAPlannerROS", "min_vel_trans", 0.11, 0.04)
    crossed_robot = with_changes(BURGER, [crossed], "crossed")
    cause = Candidate((lowered,), replaces_unusual=True)
    assert cause in candidates_of(crossed_robot).unusual
    # A sound robot has no unusual value that could be a cause.
    assert candidates_of(BURGER).unusual == []
    assert not any(candidate.replaces_unusual for candidate in candidates_of(BURGER).others)


def in_both(servers, name, before, after):
    """Return the change of a parameter in the local and global costmap."""
    return [Change(server, name, before, after) for server in servers]


# Footprint [m], about ten times as wide as a Burger
SQUARE = str([[-1, -1], [-1, 1], [1, 1], [1, -1]])
# Mistakes that people make in the Burger's files, each far from any usual value.
FAULTS = {
    "footprint": in_both(COSTMAPS, "footprint", "", SQUARE),
    "footprint_padding": in_both(COSTMAPS, "footprint_padding", 0.01, 0.4),
    "obstacle_range": [Change("local_costmap", "obstacle_range", 3.0, 0.5)],
    "raytrace_range": [Change("local_costmap", "raytrace_range", 3.5, 0.5)],
    "controller_frequency": [Change("", "controller_frequency", 10.0, 2.0)],
    "cost_scaling_factor": in_both(INFLATION_LAYERS, "cost_scaling_factor", 3.0, 0.2),
    "inflation_radius": in_both(INFLATION_LAYERS, "inflation_radius", 1.0, 4.0),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_value_of_a_file_that_departs_most_is_the_first_candidate(name):
    robot = with_changes(BURGER, FAULTS[name], "burger with a fault")
    candidate, *_ = all_candidates(robot)
    assert candidate.names == [name]
    # The candidate must be valid, too: move_base starts with it.
    MoveBase(with_changes(robot, candidate.changes, "mended").parameters())


def test_the_outline_of_the_body_takes_the_place_of_a_larger_footprint():
    robot = with_changes(BURGER, FAULTS["footprint"], "burger with a fault")
    candidate, *_ = all_candidates(robot)
    assert str(candidate) == "footprint 2.00 x 2.00 m -> the outline of the body, 0.14 x 0.18 m"
    assert candidate.before == "footprint 2.00 x 2.00 m"
    for change in candidate.changes:
        corners = np.array(yaml.safe_load(change.after))
        assert np.ptp(corners, axis=0) == pytest.approx((0.14, 0.18), abs=0.005)


def test_a_robot_is_tried_with_obstacles_marked_two_seconds_ahead_or_as_far_as_its_policy_asks(
    monkeypatch,
):
    def tried_ranges():
        """Return the ranges that the candidate gives to both costmaps, cleared beyond."""
        (farther,) = (
            candidate
            for candidate in all_candidates(JACKAL)
            if candidate.names == ["obstacle_range", "raytrace_range"]
        )
        robot = with_changes(JACKAL, farther.changes, "jackal that sees farther")
        return [source.obstacle_range for source in laser_sources(robot.parameters())]

    # The included policy was made for 5 m.
    assert tried_ranges() == [5.0, 5.0]
    monkeypatch.setattr(methods, "obstacle_ranges", lambda robot: set())
    assert tried_ranges() == [4.0, 4.0]
    # The Burger, which drives 0.22 m/s, sees far enough. So does a Jackal whose sources have 5 m,
    # whatever the sections around them have.
    for robot in (BURGER, JACKAL.seeing(5.0)):
        for candidate in all_candidates(robot):
            assert "obstacle_range" not in candidate.names


def test_no_footprint_below_the_body_and_no_padding_below_the_default_is_a_candidate():
    for candidate in all_candidates(BURGER):
        assert not {"footprint", "footprint_padding"} & set(candidate.names)
    # The Jackal's files have a padding above the default of the C++ costmap.
    of_jackal = list(map(str, all_candidates(JACKAL)))
    assert "footprint_padding 0.1 -> 0.01 in both costmaps" in of_jackal


def test_a_usual_window_is_not_tried():
    """The Jackal's local costmap of 10 m is large enough, as one of 3 m is for a Burger."""

    window = {"local_costmap": {"width": 3.0, "height": 3.0}}
    small_window = JACKAL.with_parameters(window, "jackal with a small window")
    words = {str(candidate): candidate.before for candidate in all_candidates(small_window)}
    assert words["local costmap 3 x 3 -> 6 x 6 m"] == "local costmap 3 x 3"
    for candidate in [*all_candidates(JACKAL), *all_candidates(BURGER)]:
        assert candidate.names != ["width", "height"]
