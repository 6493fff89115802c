"""Tests of the viewer without a browser: access control, silent nodes, sliders, methods,
subscriptions.
"""

import contextlib
import http.client
import socket
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry

from applr_ros1.nodes.viewer.node import Viewer
from applr_ros1.robots import JACKAL
from tests.support.nodes import FakeJackal
from tests.support.ros import LONGEST, free_port, session, wait_for

viser = pytest.importorskip("viser")
pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def ros():
    """Return the master of this process's tests."""
    return session()


@pytest.fixture
def viewer(ros):
    """Return a viewer of the Jackal on a free port."""
    viewer = Viewer(JACKAL, "", "odom", free_port())
    yield viewer
    viewer.close()


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Allow for slow services on a busy machine."""
    monkeypatch.setattr("applr_ros1.nodes.viewer.listening.ANSWER_S", LONGEST)


@pytest.mark.parametrize(
    ("path", "host", "origin", "reason"),
    [
        # tests/nodes/test_viewer_admission.py has further ones of each kind.
        ("/TOKEN", "localhost:PORT", "http://localhost:PORT", None),
        ("/", "127.0.0.1:PORT", None, "lacks the token"),
        ("/TOKEN", "127.0.0.1:PORT", "http://evil.example", "another website"),
        # A website whose name has been made to lead to this computer
        ("/TOKEN", "evil.example:PORT", "http://evil.example:PORT", "not a name of this computer"),
    ],
)
def test_page_and_websocket_require_the_token_and_refuse_other_websites(
    viewer, path, host, origin, reason
):
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    address = urlsplit(viewer.address)
    port = address.port
    token = address.path.split("/")[1]

    def filled(text):
        """Return a text with this viewer's token and port."""
        return text.replace("TOKEN", token).replace("PORT", str(port))

    path = filled(path)
    host = filled(host)
    headers = {"Host": host}
    if origin is not None:
        origin = filled(origin)
        headers["Origin"] = origin

    # The page
    page_connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LONGEST)
    page_connection.request("GET", path, headers=headers)
    answer = page_connection.getresponse()
    assert answer.status == (403 if reason else 200)
    assert (reason or "<html") in answer.read().decode()
    page_connection.close()

    # The websocket. A socket of its own, because a name such as evil.example leads nowhere here.
    with pytest.raises(InvalidStatus, match="403") if reason else contextlib.nullcontext():
        own_socket = socket.create_connection(("127.0.0.1", port))
        protocol = "viser-v" + viser.__version__
        websocket_url = "ws://" + host + path
        connect(websocket_url, sock=own_socket, origin=origin, subprotocols=[protocol]).close()


@pytest.mark.parametrize("header", ["Origin", "Host"])
def test_a_duplicate_header_is_refused(viewer, header):
    address = urlsplit(viewer.address)
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=LONGEST)
    connection.putrequest("GET", address.path, skip_host=True)
    headers = {"Host": address.netloc, "Origin": "http://" + address.netloc}
    for header_name, header_text in headers.items():
        connection.putheader(header_name, header_text)
    # Of two headers, the check and the server could each read another one.
    connection.putheader(header, headers[header])
    connection.endheaders()
    assert connection.getresponse().status >= 400
    connection.close()


def state(viewer):
    """Draw, and return the text of the page's status."""
    viewer.draw()
    return viewer.text


def test_a_click_on_the_ground_sets_a_goal(ros, viewer):
    goals = []
    subscriber = rospy.Subscriber("/move_base_simple/goal", PoseStamped, goals.append)
    wait_for(subscriber.get_num_connections, "the connection")
    viewer.scene.pose = (1.0, 1.0, 0.0)

    def click():
        """Click where a ray from above meets the ground, at (2, 1), and return the goals so far."""
        viewer.clicked(SimpleNamespace(ray_origin=(1.0, 0.0, 2.0), ray_direction=(0.5, 0.5, -1.0)))
        return goals

    # A goal is lost until the publisher knows of the subscriber, too.
    wait_for(click, "the goal")
    subscriber.unregister()
    target_pose = goals[0]
    assert target_pose.header.frame_id == "odom"
    assert (target_pose.pose.position.x, target_pose.pose.position.y) == (2.0, 1.0)
    assert target_pose.pose.orientation.z == pytest.approx(0.0)  # away from the robot


def by_hand(element, value):
    """Change an element of the page, as viser does when a user changes it."""
    element.value = value
    for callback in element._impl.update_cb:
        callback(SimpleNamespace(client=object(), target=element))


def test_silent_nodes_and_topics_are_reported(viewer):
    status_text = state(viewer)
    assert "no move_base: nothing on /move_base/status" in status_text
    assert "no scan: nothing on /front/scan" in status_text
    assert "no applr node" in status_text
    reports = []
    viewer.panel.report = reports.append
    by_hand(viewer.panel.sliders["max_vel_x"], 0.8)
    assert reports == ["no subscribers on /applr/set_parameters"]


def test_robot_and_scan_are_drawn_while_a_page_is_open(ros):
    jackal = FakeJackal([(1.5, 0.8, 0.15)])
    node = ros.node("viewer", "_port:=%d" % free_port())
    viewer = Viewer(JACKAL, "", "odom", free_port())
    try:
        odometry = rospy.Publisher("/odometry/filtered", Odometry, queue_size=1)
        node.until("the page is at")
        without_page = odometry.get_num_connections()
        wait_for(lambda: state(viewer) and viewer.scene.pose, "the robot")
        wait_for(
            lambda: odometry.get_num_connections() == without_page + 1,
            "the page's subscription alone",
        )
        wait_for(lambda: state(viewer) and viewer.scene.scan.visible, "the scan")
        scan_x = viewer.scene.scan.points[:, 0]
        scan_y = viewer.scene.scan.points[:, 1]
        assert np.hypot(scan_x - 1.5, scan_y - 0.8).min() < 0.2
        wait_for(lambda: "no scan" not in state(viewer), "the end of the warning")
        jackal.put((0.2, 0.0, 0.0))
        wait_for(lambda: state(viewer) and viewer.scene.pose[0] > 0.1, "the robot has moved")
    finally:
        viewer.close()
        assert node.end() == 0, node.text
        jackal.close()
