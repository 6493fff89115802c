"""The viewer's page in a real browser, beside the whole stack: bar, sliders, clicks, obstacles, a race."""

import math
import time

import pytest
import rospy
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool
from visualization_msgs.msg import MarkerArray

from tests.support.ros_harness import free_port, session, wait_for

pytest.importorskip("viser")
from tests.support.browser import PROGRAM, open_page, press  # noqa: E402, it needs what viser brings

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no headless Chromium here"),
]

NODES = {
    "sim_bridge": ("_simulator:=kinematic", "_real_time_factor:=2"),
    "move_base": (),
    "applr": (),
    "viewer": ("_port:=%d" % free_port(),),
}
WIDTH, HEIGHT = 1000, 640


def start(name, **env):
    return session().node(name, "_robot:=jackal", *NODES[name], **env)


@pytest.fixture(scope="module")
def nodes():
    session()
    rospy.set_param("/use_sim_time", True)
    made = {name: start(name) for name in NODES}
    try:
        yield made
    finally:
        for node in reversed(made.values()):
            node.end()
        for name in NODES:
            rospy.delete_param("/" + name)
        rospy.set_param("/use_sim_time", False)


@pytest.fixture(scope="module")
def page(nodes, tmp_path_factory):
    viewer = nodes["viewer"]
    wait_for(lambda: rospy.get_param("/viewer/address", "") or not viewer.alive(), 60.0, "the page")
    assert viewer.alive(), viewer.text
    with open_page(rospy.get_param("/viewer/address"), tmp_path_factory.mktemp("browser"), WIDTH, HEIGHT) as made:
        made.wait("waits for a goal", "parameters by policy", seconds=90.0)
        yield made
        assert made.look(0.1) == []


def rectangle(page, selector):
    """(left, top, right, bottom) [pixels] of an element."""
    found = "(r => [r.left, r.top, r.right, r.bottom])(document.querySelector('%s').getBoundingClientRect())"
    return page.evaluate(found % selector)


def shown(page, node):
    """Whether a node of the scene can be seen."""
    return page.evaluate("window.__viserSceneTree.getState()['%s'].effectiveVisibility" % node)


def max_vel_x():
    return rospy.get_param("/move_base/TrajectoryPlannerROS/max_vel_x")


def table(page):
    """The rows of the table of drives, the newest first: (world, parameters by, seconds, how it ended)."""
    cells = "[...document.querySelectorAll('table')].filter(t => t.innerText.includes('parameters by'))"
    rows = page.evaluate(cells + ".flatMap(t => [...t.querySelectorAll('td')]).map(cell => cell.textContent.trim())")
    return list(zip(*(rows[k::4] for k in range(4))))


def ahead(page):
    """The place a metre ahead of the robot, where the camera looks: the middle of the scene."""
    left, top, right, bottom = rectangle(page, "canvas[data-engine]")
    return (left + right) / 2, (top + bottom) / 2


def test_a_slider_moved_on_the_page_changes_the_parameter_in_move_base(page):
    assert max_vel_x() == 0.5
    page.slide("max_vel_x [m/s]", 0.9)
    wait_for(lambda: max_vel_x() == pytest.approx(1.82, abs=0.1), 10.0, "the parameter")
    page.wait("parameters by hand")
    time.sleep(1.0)
    assert max_vel_x() == pytest.approx(1.82, abs=0.1)
    press(page, "Hand back")
    page.wait("parameters by policy")
    wait_for(lambda: max_vel_x() == 0.5, 10.0, "the default, before the first goal")


def test_a_second_page_shows_the_same_and_closes_alone(page, tmp_path):
    with open_page(rospy.get_param("/viewer/address"), tmp_path, 500, HEIGHT) as second:
        second.wait("parameters by policy", "max_vel_x [m/s]")
        page.slide("max_vel_x [m/s]", 0.9)
        second.wait("parameters by hand")
        wait_for(
            lambda: second.value("max_vel_x [m/s]") == page.value("max_vel_x [m/s]") == max_vel_x() > 1.7,
            10.0,
            "the slider",
        )
        second.slide("max_vel_x [m/s]", 0.5)
        wait_for(lambda: page.value("max_vel_x [m/s]") == max_vel_x() < 1.2, 10.0, "the slider of the first page")
        assert second.look(0.1) == []
    time.sleep(0.5)
    assert page.value("max_vel_x [m/s]") == max_vel_x()
    press(page, "Hand back")
    page.wait("parameters by policy")


def test_the_bar_stays_and_stops_the_robot(page):
    panel = rectangle(page, "[role=tab]")
    assert rectangle(page, "canvas[data-engine]")[2] <= panel[0]  # the scene has what the panel leaves
    press(page, "Go")
    page.wait("drives to a goal")
    press(page, "Stop")
    page.wait("goal cancelled")
    assert rectangle(page, "#bar")[3] == HEIGHT


def test_a_clock_that_stands_is_said_and_nobody_is_blamed_for_it(page):
    pause = rospy.ServiceProxy("/sim_bridge/pause", SetBool)
    pause(True)
    page.wait("the clock stands still")
    page.look(2.0)
    assert "waits for a goal" in page.text or "goal cancelled" in page.text
    pause(False)
    wait_for(lambda: "the clock stands still" not in page.text, 10.0, "the clock")


def test_the_view_changes_by_a_button(page):
    for view in ("above", "free", "behind"):
        page.click_on("View: " + {"above": "behind", "free": "above", "behind": "free"}[view], kind="#buttons button")
        page.wait("View: " + view)


def test_on_a_telephone_a_tap_sets_a_goal_and_nothing_leaves_the_screen(page, tmp_path):
    page.turn_to("World", "load this world")
    page.click_on("back to the start")
    goals = []
    told = rospy.Subscriber(
        "/move_base/goal", MoveBaseActionGoal, lambda m: goals.append(m.goal.target_pose.pose.position)
    )
    with open_page(rospy.get_param("/viewer/address"), tmp_path, 390, 844) as small:
        small.call("Emulation.setTouchEmulationEnabled", enabled=True)
        small.wait("View: behind", "Take over")
        wait_for(lambda: rectangle(small, "canvas[data-engine]")[3] < 0.6 * 844, 10.0, "the sheet")
        beyond = "[...document.body.querySelectorAll('*')].filter(e => e.getBoundingClientRect().right > 390.5)"
        assert small.evaluate(beyond + ".map(e => e.outerHTML.slice(0, 99))") == []
        small.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[dict(zip("xy", ahead(small)))])
        small.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        goal = wait_for(lambda: goals, 10.0, "a goal")[0]
        assert 0.5 < math.hypot(goal.x, goal.y) < 2.0  # from the start, a metre ahead
    told.unregister()


@pytest.mark.long  # beside other programs a page that is drawn in software misses clicks into the scene
def test_a_click_sets_a_goal_and_the_robot_arrives(page):
    page.turn_to("World", "load this world")
    factor = rospy.Publisher("/sim_bridge/real_time_factor", Float64, queue_size=1, latch=True)
    wait_for(factor.get_num_connections, 10.0, "the simulator")
    factor.publish(0.03)  # else it arrives before anybody has seen the goal: a page may draw nothing for seconds
    try:
        page.click(*ahead(page))
        wait_for(lambda: shown(page, "/goal") and shown(page, "/global plan/line"), 20.0, "goal and plan")
        factor.publish(1.0)
        page.turn_to("Race", "end the race")
        wait_for(lambda: table(page), 60.0, "a drive")
        wait_for(
            lambda: not shown(page, "/goal") and not shown(page, "/global plan/line"), 5.0, "neither: they held no more"
        )
    finally:
        factor.publish(2.0)
    assert table(page)[0][3] == "goal reached"
    assert float(table(page)[0][2].split()[0]) > 0.5


@pytest.mark.long  # beside other programs a page that is drawn in software misses clicks into the scene
def test_an_obstacle_put_down_is_driven_around(page):
    page.turn_to("World", "load this world")
    page.click_on("back to the start")
    heard = []
    told = rospy.Subscriber("/sim_bridge/obstacles", MarkerArray, lambda m: heard.append(len(m.markers)))
    wait_for(lambda: heard, 5.0, "obstacles")
    before = heard[-1]
    time.sleep(1.0)  # the camera follows the robot to its start
    page.choose("sets a goal", "puts an obstacle down")
    page.click(*ahead(page))
    wait_for(lambda: heard[-1] == before + 1, 10.0, "the obstacle")
    told.unregister()
    press(page, "Go")
    page.turn_to("Race", "end the race")
    wait_for(lambda: table(page)[0][3] == "finished", 40.0, "the finish, without a contact")


@pytest.mark.long  # it begins where the two before it have ended
def test_a_race_ends_with_two_times(page):
    page.turn_to("Race", "end the race")
    drives = len(table(page))
    page.click_on("race")
    page.wait("% faster than default parameters", seconds=90.0)
    assert len(table(page)) == drives + 2
    assert "winner" in table(page)[0][3]

    def legend():
        lines = page.evaluate("document.getElementById('legend').innerText").splitlines()
        return [("policy" in line, "winner" in line) for line in sorted(lines)]

    wait_for(lambda: legend() == [(False, False), (True, True)], 10.0, "the winner in the legend")
    second, first = table(page)[:2]
    assert [first[1], second[1]] == ["default parameters", "policy"]
    assert float(first[2].split()[0]) > float(second[2].split()[0]) > 3.0
    assert rospy.wait_for_message("/sim_bridge/current_world", String, 5.0).data == first[0] == "generated:0"
