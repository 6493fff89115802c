"""Tests of what the collision monitor's node reports about itself."""

from types import SimpleNamespace

import pytest

from applr_ros1.monitor.monitor import BRAKE, PASS, SLOW, STOP, Verdict
from applr_ros1.nodes.monitor.node import ESCAPE
from applr_ros1.nodes.monitor.reports import MonitorReports, topic_named

PASSES = Verdict((0.3, 0.0))
BRAKES = Verdict((0.3, 0.0), BRAKE, reason="braking as the planner asks")
ESCAPES = Verdict((-0.1, 0.0), ESCAPE, reason="move_base makes no progress")
STOPS = Verdict.stop((0.0, 0.0), "a wall")
CONTRADICTS = "the odometry's velocity is 0"
RECENT_S = 0.1
LONG_S = 2.1


@pytest.mark.parametrize(
    ("verdict", "silence", "odometry_problem", "status"),
    [
        (PASSES, RECENT_S, "", (False, "commands pass")),
        (BRAKES, RECENT_S, "", (False, "braking as the planner asks")),
        (PASSES, RECENT_S, CONTRADICTS, (True, CONTRADICTS)),
        (STOPS, RECENT_S, "", (True, "a wall")),
        (ESCAPES, RECENT_S, "", (True, "move_base makes no progress")),
        (STOPS, RECENT_S, CONTRADICTS, (True, "a wall")),
        (STOPS, LONG_S, "", (False, "idle: no commands")),
        (STOPS, LONG_S, CONTRADICTS, (True, CONTRADICTS)),
    ],
)
def test_a_stop_is_reported_before_odometry_that_contradicts_the_pose(
    verdict, silence, odometry_problem, status
):
    reports = MonitorReports([PASS, BRAKE, SLOW, STOP])
    assert reports.status(verdict, silence, odometry_problem, 100.0) == status


def test_a_stray_laser_is_a_problem_for_a_minute():
    reports = MonitorReports([PASS])
    stray = SimpleNamespace(frame="stray", count=3)
    line = reports.let_go(stray, "/stray_driver", "/scan", 100.0)
    assert line.startswith("/stray_driver has sent no scan of frame 'stray' on /scan for 5 s (3 ")
    assert reports.status(PASSES, RECENT_S, "", 159.0) == (True, line)
    assert reports.status(PASSES, RECENT_S, CONTRADICTS, 159.0) == (True, CONTRADICTS)
    assert reports.status(PASSES, RECENT_S, "", 161.0) == (False, "commands pass")
    # Another one begins the minute anew.
    reports.let_go(stray, "/stray_driver", "/scan", 170.0)
    assert reports.status(PASSES, RECENT_S, "", 229.0) == (True, line)


@pytest.mark.parametrize(
    ("reason", "topic"),
    [
        ("the latest scan is 0.60 s old; the limit is 0.5 s", "scan"),
        ("the latest scan on rear is 0.60 s old; the limit is 0.5 s", "rear"),
        ("scan on rear: the scanner is blind", "rear"),
        ("scan on rear/low of frame low_2: the scanner is blind", "rear/low"),
    ],
)
def test_a_stop_for_a_scan_names_its_topic(reason, topic):
    assert topic_named(reason, "scan", ["rear", "rear/low"]) == topic
