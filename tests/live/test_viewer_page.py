"""The viewer's page in a real browser, beside the whole stack: sliders, methods, a goal by a click, stop."""

import pytest
import rospy
from std_srvs.srv import Empty

from tests.support.ros_harness import free_port, session, wait_for

pytest.importorskip("viser")
from tests.support.browser import PROGRAM, open_page  # noqa: E402, it needs what viser brings

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(PROGRAM is None, reason="no headless Chromium here"),
]

NODES = {
    "sim_bridge": ("_simulator:=kinematic", "_gazebo:=true"),
    "move_base": (),
    "applr": (),
    "viewer": ("_port:=%d" % free_port(),),
}
AHEAD = (305, 250)  # point of the page where the scene shows the ground ahead of the robot [px]
SPEED = "/move_base/TrajectoryPlannerROS/max_vel_x"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    ros = session()
    rospy.set_param("/use_sim_time", True)
    nodes = {name: ros.node(name, "_robot:=jackal", *NODES[name]) for name in NODES}
    viewer = nodes["viewer"]
    try:
        viewer.until(lambda: rospy.get_param("/viewer/address", ""))
        with open_page(rospy.get_param("/viewer/address"), tmp_path_factory.mktemp("browser")) as made:
            made.wait("waits for a goal", "parameters by policy")
            yield made
            assert made.look(0.1) == []
    finally:
        for node in reversed(nodes.values()):
            node.end()
        for name in NODES:
            rospy.delete_param("/" + name)
        rospy.set_param("/use_sim_time", False)


def test_a_slider_moved_on_the_page_changes_the_parameter_in_move_base(page):
    assert rospy.get_param(SPEED) == 0.5

    def slid():
        page.slide("max_vel_x [m/s]", 0.9)
        return rospy.get_param(SPEED) == pytest.approx(1.82, abs=0.1)

    wait_for(slid, "the parameter")
    page.wait("parameters by hand")
    page.choose("hand", "policy")
    page.wait("parameters by policy")
    wait_for(lambda: rospy.get_param(SPEED) == 0.5, "the default, before the first goal")


def test_the_robot_goes_to_a_click_and_stops(page):
    def stopped():
        """False if the robot arrived or gave up before the click on the button."""
        page.click(*AHEAD)
        page.wait("drives to a goal")
        page.press("Stop", "goal cancelled", "arrived", "gave up")
        return "goal cancelled" in page.text

    wait_for(stopped, "a goal that is cancelled")


def test_a_clock_that_stands_is_said_and_nobody_is_blamed_for_it(page):
    rospy.ServiceProxy("/gazebo/pause_physics", Empty)()
    page.wait("the clock stands still")
    assert "does not answer" not in page.text
    rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
    wait_for(lambda: "the clock stands still" not in page.text, "the clock")
