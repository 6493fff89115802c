"""What the applr node says of the planner's distance weights, without a planner."""

import pytest

rospy = pytest.importorskip("rospy")

from applr_ros1.nodes.applr import meter_scoring  # noqa: E402
from applr_ros1.policy.parameter_space import SPACE, space_of  # noqa: E402
from applr_ros1.robots import load  # noqa: E402


class Client:
    namespace, servers = "/move_base", {"TrajectoryPlannerROS": "/move_base/TrajectoryPlannerROS"}

    def __init__(self, space):
        self.space = space


class Silent:
    """In the place of a rospy.Subscriber; nobody publishes."""

    def __init__(self, *_, **__):
        pass

    def unregister(self):
        pass


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(meter_scoring.rospy, "Subscriber", Silent)
    return lambda space=SPACE: meter_scoring.MeterScoring(Client(space))


def test_without_a_cost_cloud_it_says_so_and_waits_again_after_a_restart(made):
    scoring = made()
    for began in (100.0, 200.0):
        now = rospy.Time(began)
        assert scoring.line(now) == ""  # there was no occasion yet
        scoring.look(now, driving=True)
        assert scoring.waits(now)
        assert scoring.line(now) == ""
        later = rospy.Time(began + 2.0)
        assert scoring.look(later, driving=True)
        assert "no cost_cloud on /move_base/TrajectoryPlannerROS/cost_cloud" in scoring.line(later)
        assert not scoring.waits(later)
        scoring.forget()


def test_a_robot_with_another_planner_is_told_at_once(made):
    scoring = made(space_of(load("husky")))
    assert scoring.line(rospy.Time(1.0)).startswith("sets are sent as they are: only the distance weights of Traj")
    assert not scoring.waits(rospy.Time(1.0))
