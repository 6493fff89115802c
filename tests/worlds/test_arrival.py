"""Tests of the conditions of arrival: finish line, circle around the goal, planner's report."""

import numpy as np
import pytest

import worlds
from worlds import Course, barn

TOLERANCE_M = 0.25  # goal tolerance of the planner that reports its goal as reached


def course(length, finish_y=None, planner_ends=True):
    """Return a straight course along y with a circle of 0.3 m around its goal."""
    return Course(
        start=(0.0, 0.0, 1.57),
        goal=(0.0, length, 1.57),
        finish_y=finish_y,
        goal_tolerance=0.3,
        path=np.array([(0.0, 0.0), (0.0, length)]),
        planner_ends=planner_ends,
    )


@pytest.mark.parametrize(
    ("length", "odometry_error"),
    [
        (4.0, 0.5),
        (10.0, 0.8),
        (20.0, 1.6),
    ],
)
def test_the_planners_report_counts_within_the_error_of_odometry(length, odometry_error):
    """The allowed error is 0.5 m, or 8 % of a longer route, beyond the planner's tolerance."""
    straight_course = course(length)
    limit = TOLERANCE_M + odometry_error
    # A goal beyond the planner's map is sent 19.7 m ahead.
    sent_y = min(length, 19.7)
    for side in (-1.0, 1.0):
        inside = side * (limit - 0.01)
        outside = side * (limit + 0.01)
        assert straight_course.arrived(inside, sent_y, TOLERANCE_M)
        assert not straight_course.arrived(outside, sent_y, TOLERANCE_M)
        assert not straight_course.arrived(inside, sent_y), "the planner reports nothing"
    assert straight_course.arrived(0.29, length)
    assert not course(length, planner_ends=False).arrived(0.31, length, TOLERANCE_M)


def test_a_course_with_a_finish_of_its_own_ignores_the_planner():
    line = course(10.0, finish_y=9.0, planner_ends=False)
    assert line.arrived(3.0, 9.01)
    assert not line.arrived(0.5, 9.0, TOLERANCE_M)

    # The challenge's circle has a radius of 1 m around (-2.25, 13).
    challenge = barn.challenge_course(np.array([(0.0, 5.0), (0.0, 9.0)]))
    assert challenge.arrived(-2.25, 12.01)
    assert not challenge.arrived(-2.25, 11.99, TOLERANCE_M)


@pytest.mark.parametrize(
    ("finish_y", "route_m"),
    [
        (10.0, 2.0 + 5.0 + 3.0 + 1.0),
        (None, 2.0 + 5.0 + 3.0 + 5.0 + 2.0),
    ],
)
def test_a_route_goes_from_the_start_along_the_path_to_the_finish(finish_y, route_m):
    """BARN's metric has its optimal time from the length. The last way to a line is straight."""
    bent_course = Course(
        start=(0.0, 0.0, 1.57),
        goal=(6.0, 15.0, 1.57),
        finish_y=finish_y,
        goal_tolerance=0.3,
        path=np.array([(0.0, 2.0), (3.0, 6.0), (3.0, 9.0), (6.0, 13.0)]),
    )
    assert bent_course.route_m == pytest.approx(route_m)


@pytest.mark.parametrize(
    ("name", "planner_ends"),
    [
        ("generated:7", False),
        ("physical_course", False),
        ("dynamic:406", True),
    ],
)
def test_only_courses_of_rooms_have_no_finish_of_their_own(name, planner_ends):
    assert worlds.load(name).course.planner_ends is planner_ends
