"""The viewer's page of a bag that is replayed, in a real browser."""

import genpy
import pytest
import rosbag
import rospy
from applr_ros1.msg import Decision
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

from tests.support.fake_jackal import _transform
from tests.support.ros_harness import free_port, session, wait_for

pytest.importorskip("viser")
from tests.support.browser import PROGRAM, open_page, press  # noqa: E402, it needs what viser brings

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no headless Chromium here"),
]
LENGTH = 600  # s, of which a slow page misses many


def test_a_replay_is_paused_sought_and_begun_again(tmp_path):
    """A robot that drives ahead at 0.5 m/s, with a decision every hundred seconds."""
    with rosbag.Bag(str(tmp_path / "drive.bag"), "w") as bag:
        for k in range(LENGTH + 1):
            now = genpy.Time(100 + k)
            odometry = Odometry()
            odometry.header.stamp, odometry.twist.twist.linear.x = now, 0.5
            bag.write("/odometry/filtered", odometry, now)
            bag.write("/tf", TFMessage([_transform("odom", "base_link", (0.5 * k, 0.0, 0.0), now)]), now)
            if k % 100 == 0:
                decision = Decision()
                decision.before.values, decision.after.values = [0.5], [0.5 + k]
                bag.write("/applr/decision", decision, now)
    ros = session()
    rospy.set_param("/use_sim_time", True)
    rospy.set_param("/play/arguments", ["seed:=3"])
    player = ros.node("replay", str(tmp_path / "drive.bag"))
    words = "_replay:=true", "_port:=%d" % free_port()
    node = ros.node("viewer", *words, APPLR_PLAY_FOLDER=str(tmp_path))
    try:
        wait_for(lambda: rospy.get_param("/viewer/address", ""), 60.0, "the page")
        with open_page(rospy.get_param("/viewer/address"), tmp_path) as page:
            page.wait("Pause", "0.50 m/s", seconds=60.0)
            for absent in ("Go", "Stop", "Take over", "World", "Race", "parameters by policy"):
                assert absent not in page.text.splitlines(), absent

            def at():
                return page.value("time [s]")

            page.slide("time [s]", 0.99)
            page.wait("Again", seconds=30.0)
            assert at() == pytest.approx(LENGTH, abs=0.4)
            press(page, "Again")
            page.wait("Pause")
            press(page, "Pause")
            page.wait("Play")
            paused = at()
            assert paused < 0.5 * LENGTH
            page.look(2.0)
            assert at() == pytest.approx(paused, abs=0.5)
            page.slide("time [s]", 0.75)
            wait_for(lambda: at() > 0.7 * LENGTH and "Pause" in page.text, 20.0, "the new time")
            page.turn_to("Bags", "record:=drive.bag")
            assert page.evaluate("[...document.querySelectorAll('input')].some(e => e.value == 'drive.bag')")
            page.click_on("open")
            page.wait("drive.bag starts")
            assert rospy.get_param("/play/arguments") == ["seed:=3", "bag:=%s" % (tmp_path / "drive.bag")]
            assert page.look(0.1) == []
    finally:
        assert node.end() == 0, node.text
        player.end()
        for name in ("/viewer", "/play"):
            rospy.delete_param(name)
        rospy.set_param("/use_sim_time", False)
