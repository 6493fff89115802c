"""Tests of the conditions of arrival: finish line, circle around the goal, and the planner's
report.
"""

import numpy as np
import pytest

import worlds
from worlds import Course, barn


def course(length, finish_y=None, planner_ends=True):
    path = np.array([(0.0, 0.0), (0.0, length)])
    return Course((0.0, 0.0, 1.57), (0.0, length, 1.57), finish_y, 0.3, path, planner_ends)


@pytest.mark.parametrize(("length", "off"), [(4.0, 0.5), (10.0, 0.8), (20.0, 1.6)])
def test_the_planners_report_counts_within_the_error_of_odometry(length, off):
    """The allowed error is 0.5 m, or 8 % of a longer route, beyond the planner's tolerance of 0.25
    m.
    """
    there = course(length)
    for side in (-1.0, 1.0):
        sent = min(length, 19.7)
        assert there.arrived(side * (0.25 + off - 0.01), sent, 0.25)
        assert not there.arrived(side * (0.25 + off + 0.01), sent, 0.25)
        assert not there.arrived(side * (0.25 + off - 0.01), sent)
    assert there.arrived(0.29, length)
    assert not course(length, planner_ends=False).arrived(0.31, length, 0.25)


def test_the_planners_report_refers_to_the_goal_that_was_sent():
    """A goal 20 m ahead is moved to 19.7 m, inside the planner's map."""
    there = course(20.0)
    assert there.arrived(0.0, 19.7 - 1.84, 0.25)
    assert not there.arrived(0.0, 19.7 - 1.86, 0.25)


def test_a_course_with_a_finish_of_its_own_ignores_the_planner():
    line = course(10.0, finish_y=9.0, planner_ends=False)
    assert line.arrived(3.0, 9.01)
    assert not line.arrived(0.5, 9.0, 0.25)
    challenge = barn.challenge_course(np.array([(0.0, 5.0), (0.0, 9.0)]))
    assert challenge.arrived(-2.25, 12.01)
    assert not challenge.arrived(-2.25, 11.99, 0.25)


def test_only_courses_of_rooms_have_no_finish_of_their_own():
    rule = {
        name: worlds.load(name).course.planner_ends
        for name in ("generated:7", "physical_course", "dynamic:406")
    }
    assert rule == {"generated:7": False, "physical_course": False, "dynamic:406": True}
