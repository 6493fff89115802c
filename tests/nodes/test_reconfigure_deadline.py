"""By which clock the client of the planner's parameters waits for their servers."""

from concurrent.futures import Future
from types import SimpleNamespace

import pytest

from applr_ros1.nodes.applr import reconfigure_client
from applr_ros1.nodes.applr.reconfigure_client import SLOWEST, Deadline


@pytest.fixture
def clocks(monkeypatch):
    """Both clocks, to be set; `leaving`: the node shuts down."""
    now = SimpleNamespace(wall=100.0, ros=5.0, leaving=False)
    monkeypatch.setattr(reconfigure_client, "time", SimpleNamespace(monotonic=lambda: now.wall))
    core = SimpleNamespace(is_shutdown_requested=lambda: now.leaving)
    monkeypatch.setattr(reconfigure_client, "rospy", SimpleNamespace(get_time=lambda: now.ros, core=core))
    return now


@pytest.mark.parametrize(
    ("factor", "wall"),
    [(1.0, 1.0), (0.3, 1.0 / 0.3), (4.0, 1.0), (0.0, SLOWEST), (-1.0, SLOWEST)],
    ids=["real time", "slower", "faster", "stopped", "back"],
)
def test_a_deadline_is_over_by_the_clock_of_ros_and_by_the_walls(clocks, factor, wall):
    until = Deadline(1.0)
    for share, over in ((0.0, False), (0.98, False), (1.02, True)):
        clocks.wall, clocks.ros = 100.0 + share * wall, 5.0 + share * wall * factor
        assert until.is_over == over, share


def test_a_node_that_shuts_down_waits_by_the_wall_alone(clocks):
    until, clocks.leaving = Deadline(1.0), True
    clocks.wall += 0.9
    assert not until.is_over
    clocks.wall += 0.2
    assert until.is_over


def test_it_waits_for_answers_and_no_longer(clocks, monkeypatch):
    """At a third of real time a server that answers after 2 s of wall time is still in time."""
    calls, asked = [Future(), Future()], []
    calls[0].set_result("")

    def wait(pending, seconds):
        asked.append(len(pending))
        clocks.wall, clocks.ros = clocks.wall + 1.0, clocks.ros + 0.3
        if len(asked) == 2 and not calls[1].done():
            calls[1].set_result("")
        done = {call for call in pending if call.done()}
        return done, pending - done

    monkeypatch.setattr(reconfigure_client, "wait", wait)
    Deadline(1.0).wait(calls)
    assert asked == [2, 1]
    assert all(call.done() for call in calls)
    asked.clear()
    Deadline(1.0).wait([Future()])
    assert len(asked) == 4
