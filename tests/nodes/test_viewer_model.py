"""Test of the robot's model, costmaps and the camera on the viewer's page, and of its calls of
services.
"""

import asyncio
import math
import threading
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import create_autospec

import numpy as np
import pytest
import rospy
from nav_msgs.msg import OccupancyGrid

from applr_ros1.robots import JACKAL

viser = pytest.importorskip("viser")
scene = pytest.importorskip("applr_ros1.nodes.viewer.scene")
shapes = pytest.importorskip("applr_ros1.nodes.viewer.shapes")
listening = pytest.importorskip("applr_ros1.nodes.viewer.listening")


@pytest.mark.parametrize("is_round", [False, True])
def test_a_round_body_is_shown_as_a_cylinder(is_round):
    body = JACKAL.body.model_copy(update={"round": is_round, "size": (0.6, 0.5, 0.2)})
    drawn = create_autospec(viser.SceneApi, instance=True)
    shapes.Model(drawn, "/robot", replace(JACKAL, body=body), (1, 2, 3))
    cylinders = {}
    for call in drawn.add_cylinder.mock_calls:
        cylinders[call.args[0]] = call.kwargs
    assert ("/robot/body" in cylinders) is is_round
    assert drawn.add_box.called is not is_round
    if is_round:
        shown_body = cylinders["/robot/body"]
        diameter = 2.0 * shown_body["radius"]
        assert [diameter * scale for scale in shown_body["scale"]] == [0.6, 0.5, 1.0]
        assert shown_body["height"] == 0.2


def test_an_arrow_on_the_body_points_to_its_front():
    drawn = create_autospec(viser.SceneApi, instance=True)
    shapes.Model(drawn, "/robot", JACKAL, (1, 2, 3))
    (arrow,) = drawn.add_mesh_simple.mock_calls
    _, corners, _ = arrow.args
    body = JACKAL.body
    length, width, height = body.size
    tip = corners[np.argmax(corners[:, 0])]
    np.testing.assert_allclose(tip, (length / 2.0, 0.0, 0.0))
    assert np.abs(corners[:, 1]).max() < width / 2.0
    *middle, arrow_height = arrow.kwargs["position"]
    assert tuple(middle) == tuple(body.centre)
    assert arrow_height == pytest.approx(body.bottom + height, abs=0.01)
    assert arrow_height > body.bottom + height


def test_a_handle_is_put_on_the_ground_with_the_heading_of_the_pose():
    handle = SimpleNamespace()
    shapes.put(handle, (1.0, 2.0, np.pi / 2.0))
    assert handle.position == (1.0, 2.0, 0.0)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(handle.wxyz, (half, 0.0, 0.0, half), atol=1e-12)


def camera_at(position, look_at):
    """Return a camera as a page reports it."""
    return SimpleNamespace(position=np.array(position), look_at=np.array(look_at))


def test_the_camera_stays_behind_the_robot_whatever_an_opening_page_reports():
    view = scene.CameraView(scale=1.0)
    robot_pose = (1.0, 2.0, 0.0)
    placed = camera_at((-2.5, 2.0, 2.5), (2.0, 2.0, 0.0))
    # When: the page reports its own first pose again, after it was told another one
    camera = camera_at((3.0, 3.0, 3.0), (0.0, 0.0, 0.0))
    for _ in range(2):
        view.follow(camera, robot_pose)
        camera = camera_at((3.0, 3.0, 3.0), (0.0, 0.0, 0.0))
        asyncio.run(view.take_report(camera))
    # Then: it is told again
    view.follow(camera, robot_pose)
    np.testing.assert_allclose(camera.position, placed.position)
    np.testing.assert_allclose(camera.look_at, placed.look_at)


def test_a_camera_that_the_user_has_moved_follows_the_robot():
    view = scene.CameraView(scale=1.0)
    camera = camera_at((3.0, 3.0, 3.0), (0.0, 0.0, 0.0))
    view.follow(camera, (1.0, 2.0, 0.0))
    asyncio.run(view.take_report(camera))
    # When: the user turns the camera, and the robot drives on and turns
    camera.position = np.array([2.0, -1.0, 4.0])
    asyncio.run(view.take_report(camera))
    view.follow(camera, (1.5, 2.5, 1.0))
    # Then: only the robot's motion is added
    np.testing.assert_allclose(camera.position, (2.5, -0.5, 4.0))
    # When: the clock jumps back
    view.restart()
    view.follow(camera, (0.0, 0.0, 0.0))
    # Then: the camera is behind the robot again
    np.testing.assert_allclose(camera.position, (-3.5, 0.0, 2.5))


def test_a_costmap_turns_with_its_frame():
    image = SimpleNamespace()
    viewer_scene = create_autospec(viser.SceneApi, instance=True)
    viewer_scene.add_image.return_value = image
    drawn = shapes.DrawnCostmap(viewer_scene, "/global", 0.01)
    grid = OccupancyGrid()
    grid.header.frame_id = "matched"
    grid.info.width = 4
    grid.info.height = 2
    grid.info.resolution = 1.0
    grid.info.origin.position.x = 10.0
    grid.data = [100] * 8
    drawn.replace_map(grid)
    # The frame lies at (1, 2), turned to the left.
    drawn.draw(SimpleNamespace(frame_pose=lambda frame: (1.0, 2.0, 0.5 * math.pi)))
    assert image.position == pytest.approx((1.0 - 1.0, 2.0 + 12.0, 0.01))
    half = math.sqrt(0.5)
    assert image.wxyz == pytest.approx([half, 0.0, 0.0, half])


@pytest.mark.parametrize(
    ("answer", "lines"),
    [
        ("success", []),
        ("refusal", ["it is busy"]),
        ("failure", ["/applr/enable: it has died"]),
        ("silence", ["/applr/enable does not answer"]),
    ],
)
def test_a_service_that_fails_or_never_answers_is_reported(answer, lines, monkeypatch):
    is_over = threading.Event()

    def service(request):
        if answer == "failure":
            raise rospy.ServiceException("it has died")
        if answer == "silence":  # as that of a stopped process
            is_over.wait()
        return SimpleNamespace(success=request and answer == "success", message="it is busy")

    reported = []
    monkeypatch.setattr(listening, "WORK_S", 0.05 if answer == "silence" else 10.0)
    monkeypatch.setattr(rospy, "resolve_name", lambda name: "/" + name)
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda *_: service)
    has_succeeded = listening.call(reported.append, "applr/enable", None, True)
    is_over.set()
    assert has_succeeded == (answer == "success")
    assert reported == lines
