"""Test of the robot's model on the viewer's page."""

from dataclasses import replace
from unittest.mock import MagicMock

import pytest

from applr_ros1.robots import JACKAL

shapes = pytest.importorskip("applr_ros1.nodes.viewer.shapes")


@pytest.mark.parametrize("is_round", [False, True])
def test_a_round_body_is_shown_as_a_cylinder(is_round):
    body = JACKAL.body.model_copy(update={"round": is_round, "size": (0.6, 0.5, 0.2)})
    scene = MagicMock()
    shapes.Model(scene, "/robot", replace(JACKAL, body=body), (1, 2, 3))
    cylinders = {}
    for call in scene.add_cylinder.mock_calls:
        cylinders[call.args[0]] = call.kwargs
    assert ("/robot/body" in cylinders) is is_round
    assert scene.add_box.called is not is_round
    if is_round:
        shown_body = cylinders["/robot/body"]
        diameter = 2.0 * shown_body["radius"]
        assert [diameter * scale for scale in shown_body["scale"]] == [0.6, 0.5, 1.0]
        assert shown_body["height"] == 0.2
