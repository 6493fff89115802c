"""The viewer's page in a real browser with the whole stack.

Look, sliders, methods, a goal by a click, stop.
"""

import shutil
from contextlib import suppress

import pytest
import rospy
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import Empty

from tests.support.browser import faults_of
from tests.support.ros import free_port, session, wait_for

playwright = pytest.importorskip("playwright.sync_api")
PROGRAM = shutil.which("chromium-headless-shell")
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
# Point on the page that shows the ground some metres ahead of the robot [px]. Messages, which lie
# over the scene for some seconds, end left of it.
AHEAD = (350, 230)
SPEED = "/move_base/TrajectoryPlannerROS/max_vel_x"
OPTIONS = [
    "--no-sandbox",  # The tests may run as root.
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
# Fixed pixel ratio; viser would otherwise try larger ones and freeze.
FEW_PIXELS = "fixedDpr=0.3"
# Rendering sixty frames per second in software would take the CPU time of the robot. Each frame
# still waits for the browser's own callback: frames that are requested faster than drawn would
# block the page for minutes.
TEN_FRAMES_A_SECOND = """
const turn = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = draw => setTimeout(() => turn(draw), 100);
window.cancelAnimationFrame = clearTimeout;
"""


@pytest.fixture(scope="module")
def page():
    """Start the stack, and return the viewer's page in a browser; at its end, check that the page
    had no errors and loaded nothing from elsewhere.
    """
    ros = session()
    complaints = []
    requests = []
    rospy.set_param("/use_sim_time", True)
    nodes = {name: ros.node(name, "_robot:=jackal", *NODES[name]) for name in NODES}
    try:
        nodes["viewer"].until(lambda: rospy.get_param("/viewer/address", ""))
        address = rospy.get_param("/viewer/address")
        with playwright.sync_playwright() as started:
            browser = started.chromium.launch(executable_path=PROGRAM, args=OPTIONS)
            page = browser.new_page(
                viewport={"width": 1000, "height": 640},
                device_scale_factor=0.5,
                color_scheme="dark",
            )
            page.set_default_timeout(60000.0)
            page.add_init_script(TEN_FRAMES_A_SECOND)
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", lambda request: requests.append(request.url))
            page.on(
                "console",
                lambda message: message.type == "error" and complaints.append(message.text),
            )
            page.goto(address + ("&" if "?" in address else "?") + FEW_PIXELS)
            reads(page, "waiting for a goal")
            reads(page, "a click on the ground is the next goal")
            reads(page, "parameters by policy")
            yield page
            assert complaints == []
            own_addresses = (address, "data:", "blob:")
            assert [url for url in requests if not url.startswith(own_addresses)] == []
            browser.close()
    finally:
        for node in reversed(nodes.values()):
            node.end()
        for node_name in NODES:
            rospy.delete_param("/" + node_name)
        rospy.set_param("/use_sim_time", False)


def test_the_page_has_the_look_of_all_pages_and_shuts_nobody_out(page):
    assert page.title() == "applr_ros1: jackal"
    ground = "getComputedStyle(document.querySelector('[data-dock-region=right]')).backgroundColor"
    assert page.evaluate(ground) == "rgb(19, 20, 22)", "the paper of dark pages"
    verdict = page.locator(".status .verdict")
    text_color = verdict.evaluate("element => getComputedStyle(element).color")
    assert text_color == "rgb(207, 208, 208)"
    assert page.get_by_role("slider", name="max_vel_x [m/s] 0.2 to 2").count() == 1
    page.get_by_role("tab", name="Legend and view").click()
    page.get_by_text("trajectories, cheap to dear").wait_for()
    assert faults_of(page) == []
    page.get_by_role("tab", name="Drive").click()
    assert faults_of(page) == []


def reads(page, words):
    """Wait until the page shows these words."""
    page.get_by_text(words).last.wait_for()


def test_a_slider_moved_on_the_page_changes_the_parameter_in_move_base(page):
    assert rospy.get_param(SPEED) == 0.5
    page.get_by_role("slider", name="max_vel_x [m/s]").press("End")
    wait_for(lambda: rospy.get_param(SPEED) == 2.0, "the parameter")
    reads(page, "parameters by hand")

    def chosen():
        """Choose the policy. Return whether the applr node has confirmed this; on a busy machine it
        may be too late.
        """
        page.get_by_role("combobox", name="parameters by").click()
        page.get_by_role("option", name="policy").click()
        with suppress(playwright.TimeoutError):
            page.get_by_text("parameters by policy").last.wait_for(timeout=10000.0)
        return page.get_by_text("parameters by policy").count()

    wait_for(chosen, "the policy")
    wait_for(lambda: rospy.get_param(SPEED) == 0.5, "the default, before the first goal")


def test_the_robot_goes_to_a_click_and_stops(page):
    sent_goals = []
    subscriber = rospy.Subscriber("/move_base_simple/goal", PoseStamped, sent_goals.append)
    wait_for(subscriber.get_num_connections, "the connection to the viewer")
    # Slow enough that the goal is not reached before a busy browser shows that it is active.
    page.get_by_role("slider", name="max_vel_x [m/s]").press("Home")
    wait_for(lambda: rospy.get_param(SPEED) == 0.2, "the parameter")
    page.mouse.click(*AHEAD)
    reads(page, "goal active")
    page.get_by_role("button", name="Stop").click()
    reads(page, "goal preempted")
    # The robot stands at the start of its course, the origin, and looks along y. The page looks
    # over its shoulder: the click was on the ground ahead of it.
    assert [goal.pose.position.x for goal in sent_goals] == [pytest.approx(0.9, abs=0.3)]
    assert [goal.pose.position.y for goal in sent_goals] == [pytest.approx(4.7, abs=0.5)]


def test_a_stopped_clock_is_reported_but_no_silent_nodes(page):
    rospy.ServiceProxy("/gazebo/pause_physics", Empty)()
    reads(page, "the clock has stopped")
    assert not page.get_by_text("does not answer").count()
    rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
    page.get_by_text("the clock has stopped").last.wait_for(state="hidden")
