"""The planner's thread: requests that are withdrawn, errors that are reported, changes that are published in order. No
ROS master is needed.
"""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from dynamic_reconfigure.msg import DoubleParameter

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.move_base import reconfigure_server
from applr_ros1.nodes.move_base.planner_thread import PlannerThread
from tests.support.refusals import refused
from tests.support.ros_harness import wait_for


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

    def _cycle(self, now, turn):
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


def starts(frequency, scans, seconds):
    """[(time of a cycle's start [s], time since the newest scan [s])]; scans: times at which one can be placed."""
    came, used, now, due = 0.0, 0.0, 0.0, None
    interval = scans[1] - scans[0] if scans else 0.0
    planner = PlannerThread(
        nothing,
        lambda: frequency,
        nothing,
        nothing,
        nothing,
        lambda: came > used,
        lambda: (came, came + interval if came else 0.0),
    )
    found, waiting = [], list(scans)
    for k in range(int(1000 * seconds)):
        now = 100.0 + 1e-3 * k
        while waiting and waiting[0] <= now + 1e-6:
            came = waiting.pop(0)
        if due is not None and planner._left(due.to_sec(), now, 1.0 / frequency) > 1e-6:
            continue
        due = planner._next_due(due, rospy.Time.from_sec(now), 1.0 / frequency)
        used = came
        found.append((now, now - came))
    return np.array(found)


@pytest.mark.parametrize(
    ("frequency", "rate", "first", "rates", "oldest"),
    [
        (20.0, 50.0, 100.003, (19.5, 20.5), 0.002),
        (20.0, 40.0, 100.017, (19.5, 20.5), 0.002),
        (20.0, 30.0, 100.01, (18.0, 20.5), 0.011),
        (20.0, 100.0, 100.0, (19.5, 20.5), 0.002),
        (20.0, 12.0, 100.03, (11.9, 20.5), 0.051),
        (10.0, 5.0, 100.05, (9.8, 10.2), 0.101),  # every second cycle starts with a scan
        (5.0, 50.0, 100.013, (4.9, 5.1), 0.002),
    ],
)
def test_cycles_start_with_scans_at_the_control_frequency(frequency, rate, first, rates, oldest):
    began = starts(frequency, list(first + np.arange(20 * rate) / rate), 20.0)[10:]
    assert rates[0] <= 1.0 / np.diff(began[:, 0]).mean() <= rates[1]
    assert np.diff(began[:, 0]).min() >= 0.59 / frequency
    assert began[:, 1].max() <= oldest
    if rate < frequency:
        assert (began[:, 1] <= 0.007).sum() >= 0.95 * rate * np.ptp(began[:, 0])


@pytest.mark.parametrize("scans", [[], list(100.0 + 0.02 * np.arange(250))])
def test_without_scans_cycles_go_on_at_the_control_frequency(scans):
    began = starts(20.0, scans, 10.0)[:, 0]
    assert len(began) == pytest.approx(200, abs=2)
    assert np.diff(began).max() <= 0.086  # where a scan is waited for that does not come


def test_cycles_that_were_missed_are_counted():
    planner = PlannerThread(nothing, lambda: 20.0, nothing, nothing, nothing)
    due = rospy.Time.from_sec(100.0)
    for late, missed in ((0.04, 0), (0.06, 1), (0.46, 9)):
        planner.missed = 0
        planner._next_due(due, due + rospy.Duration.from_sec(late), 0.05)
        assert planner.missed == missed


def test_a_scan_that_becomes_ready_wakes_the_thread(monkeypatch):
    rospy.rostime.set_rostime_initialized(True)
    rospy.rostime._set_rostime(rospy.Time.from_sec(100.0))  # from here on the clock is simulated, and stands
    ended, began, ready, scans = threading.Event(), [], [], [0.0]
    monkeypatch.setattr(rospy, "is_shutdown", ended.is_set)

    def cycle(now, turn):
        began.append((now.to_sec(), turn.to_sec()))
        ready.clear()

    times = (lambda: bool(ready)), (lambda: (scans[-1], scans[-1] + 1.8))
    planner = PlannerThread(cycle, lambda: 0.5, nothing, nothing, nothing, *times)
    thread = threading.Thread(target=planner.run)
    thread.start()
    try:
        wait_for(lambda: began, "a first cycle")
        rospy.rostime._set_rostime(rospy.Time.from_sec(101.75))
        scans.append(101.75)
        ready.append(True)
        planner.wake()
        wait_for(lambda: len(began) > 1, "a second cycle")
        assert began == [(100.0, 100.0), (101.75, 102.0)]
    finally:
        rospy.rostime.switch_to_wallclock()
        ended.set()
        planner.wake()
        thread.join(5.0)


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
