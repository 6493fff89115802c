"""Tests of the viewer's card of the last stop, without a page and without ROS."""

from types import SimpleNamespace

import pytest
import rospy
from applr_ros1.msg import Stop

from applr_ros1.nodes.viewer.stop_card import ANSWER, StopCard

pytest_plugins = ("tests.support.offline_ros",)
NOW_S = 1000.0


class FakePage:
    """Page with one card and one mark, and the latest answer of a black box."""

    def __init__(self):
        self.card = SimpleNamespace(content="")
        self.mark = SimpleNamespace(visible=False, position=(0.0, 0.0, 0.0))
        self.answer = None
        self.frame_poses = {"odom": (0.0, 0.0, 0.0), "map": (10.0, 0.0, 0.0)}
        server = SimpleNamespace(
            gui=SimpleNamespace(add_html=lambda content: self.card),
            scene=SimpleNamespace(add_icosphere=lambda name, radius, **look: self.mark),
        )
        listener = SimpleNamespace(latest=self.latest, frame_pose=self.frame_poses.get)
        self.stop_card = StopCard(server, listener)

    def latest(self, topic, kind):
        assert (topic, kind) == (ANSWER, Stop)
        return self.answer

    def draw(self, sentence, stamp=NOW_S - 10.0, frame="odom"):
        """Draw after an answer to a stop at (1.5, -0.5)."""
        self.answer = Stop(x=1.5, y=-0.5, sentence=sentence)
        self.answer.header.frame_id = frame
        self.answer.header.stamp = rospy.Time.from_sec(stamp)
        self.stop_card.draw()


@pytest.fixture
def page(offline_ros):
    """Return a page at the time NOW_S."""
    offline_ros.now = NOW_S
    return FakePage()


def test_without_a_stop_there_is_no_card(page):
    page.stop_card.draw()
    assert page.card.content == ""
    assert not page.mark.visible


def test_the_last_stop_is_on_the_card_and_marked_at_its_place(page):
    page.draw("the robot stood, because <a post> was near")
    assert "<p>The robot stood, because &lt;a post&gt; was near.</p>" in page.card.content
    assert page.mark.visible
    assert page.mark.position[:2] == (1.5, -0.5)
    # The answer has improved.
    page.draw("the robot stood, because of a wall", frame="map")
    assert "a wall" in page.card.content
    assert page.mark.position[:2] == (11.5, -0.5)


def test_the_place_is_not_marked_if_its_frame_is_unknown(page):
    page.draw("the robot stood", frame="elsewhere")
    assert "The robot stood." in page.card.content
    assert not page.mark.visible


def test_a_stop_of_before_the_clock_was_set_back_is_not_shown(page):
    page.draw("the robot stood")
    page.draw("the robot stood", stamp=NOW_S + 1.0)
    assert page.card.content == ""
    assert not page.mark.visible
