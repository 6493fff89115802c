"""The planner's thread: requests that are withdrawn, errors that are reported, changes that are published in order. No
ROS master is needed.
"""

import threading
import time
from types import SimpleNamespace

import pytest
import rospy
from dynamic_reconfigure.msg import DoubleParameter

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.move_base import reconfigure_server
from applr_ros1.nodes.move_base.planner_thread import PlannerThread
from tests.support.refusals import refused


@pytest.fixture
def logged(monkeypatch):
    lines = []
    monkeypatch.setattr(rospy, "logerr", lambda text, *values: lines.append(text % values))
    return lines


def nothing(*_):
    """Stands for what nobody looks at here."""


class Running:
    """A PlannerThread at 200 Hz of wall time. `hold`: while it is set, no cycle ends. takes: [s], a cycle's length."""

    takes = 0.0

    def __init__(self, monkeypatch):
        rospy.rostime.set_rostime_initialized(True)
        self.ended, self.hold, self.held = threading.Event(), threading.Event(), threading.Event()
        monkeypatch.setattr(rospy, "is_shutdown", self.ended.is_set)
        self.planner = PlannerThread(self._cycle, lambda: 200.0, nothing, nothing, nothing)
        self.thread = threading.Thread(target=self.planner.run)
        self.thread.start()

    def _cycle(self, now):
        time.sleep(self.takes)
        while self.hold.is_set():
            self.held.set()
            time.sleep(0.001)

    def block(self):
        """Returns when a cycle has begun that does not end before hold.clear()."""
        self.held.clear()
        self.hold.set()
        assert self.held.wait(5.0)

    def end(self):
        self.hold.clear()
        self.ended.set()
        self.thread.join(5.0)


@pytest.fixture
def running(monkeypatch):
    made = Running(monkeypatch)
    yield made
    made.end()


def test_cycles_that_were_missed_are_counted():
    planner = PlannerThread(nothing, lambda: 20.0, nothing, nothing, nothing)
    due = rospy.Time.from_sec(100.0)
    for late, missed, next_due in ((0.0, 0, 0.05), (0.04, 0, 0.05), (0.06, 1, 0.11), (0.46, 9, 0.51)):
        planner.missed = 0
        later = planner._next_due(due, due + rospy.Duration.from_sec(late), 0.05)
        assert (planner.missed, (later - due).to_sec()) == (missed, pytest.approx(next_due))


def test_requests_are_answered_between_cycles_that_take_too_long(running):
    running.takes = 0.02  # four times the period
    assert [running.planner.ask(lambda k=k: k, cost=k) for k in range(3)] == [0, 1, 2]


def test_a_request_that_was_not_answered_never_runs(running):
    done = []
    running.block()
    refused(lambda: running.planner.ask(lambda: done.append("late"), patience=0.05), r"did not answer within 0\.05 s")
    running.hold.clear()
    assert running.planner.ask(lambda: done.append("next")) is None  # requests are done in order
    assert done == ["next"]


def test_a_request_that_has_begun_is_waited_for(running):
    begun = threading.Event()

    def work():
        begun.set()
        time.sleep(0.2)
        return "value"

    assert running.planner.ask(work, patience=0.1) == "value"
    assert begun.is_set()


def test_requests_at_a_shutdown_are_refused(running):
    running.block()
    errors = []

    def ask():
        try:
            running.planner.ask(lambda: None)
        except ApplrError as error:
            errors.append(str(error))

    asking = threading.Thread(target=ask)
    asking.start()
    while not running.planner._requests:
        time.sleep(0.001)
    running.end()
    asking.join(5.0)
    ask()  # after the end
    assert errors == ["move_base is shutting down"] * 2


def test_an_error_in_posted_work_is_logged(running, logged):
    def fail():
        raise KeyError("three")

    running.planner.post(fail)
    running.planner.ask(lambda: None)
    (line,) = logged
    assert "KeyError" in line


def test_changes_are_published_in_the_order_in_which_they_come_into_force(running, monkeypatch):
    """From services and from the planner's own thread, as the watchdog does it."""
    published, in_force = [], []
    publisher = SimpleNamespace(publish=lambda message: published.append(message))
    monkeypatch.setattr(rospy, "Publisher", lambda *_, **__: publisher)
    monkeypatch.setattr(rospy, "Service", lambda *_: None)
    monkeypatch.setattr(rospy, "get_name", lambda: "/move_base")
    monkeypatch.setattr(
        reconfigure_server.ReconfigureServer, "_encode", lambda self, values: values["publish_frequency"]
    )

    def reconfigure(name, values):
        in_force.append(values["publish_frequency"])
        return values

    move_base = SimpleNamespace(
        servers={"local_costmap": SimpleNamespace(config="Costmap2D")},
        configuration=lambda name: {"publish_frequency": -1.0},
        reconfigure=reconfigure,
    )
    mirror = SimpleNamespace(post=lambda work: time.sleep(0.001))
    server = reconfigure_server.ReconfigureServer("local_costmap", move_base, mirror, running.planner)
    published.clear()

    def many(first):
        for number in range(first, first + 20):
            request = reconfigure_server.Reconfigure._request_class()
            request.config.doubles = [DoubleParameter("publish_frequency", float(number))]
            server._set(request)

    clients = [threading.Thread(target=many, args=(100 * i,)) for i in range(4)]
    for client in clients:
        client.start()
    for number in range(1000, 1020):
        running.planner.post(lambda number=number: server.change({"publish_frequency": float(number)}))
        time.sleep(0.002)
    for client in clients:
        client.join(10.0)
    running.planner.ask(lambda: None)
    assert len(in_force) == 100
    assert published == in_force
