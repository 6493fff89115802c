"""The viewer's card of the latest stop: what the robot did, where, and why, by the black box."""

from __future__ import annotations

import html
from typing import Any

import rospy

from applr_ros1.common.angles import transform_point
from applr_ros1.common.pages.colors import rgb
from applr_ros1.msg import Stop

from .listening import Listener

ANSWER = "black_box/answer"
RADIUS_M = 0.12  # radius of the ball that marks the place [m]


class StopCard:
    """Card in the current container of viser's page, and a mark in the scene at the stop's place.

    Attributes:
        card: The card.
        mark: The mark, hidden without a stop.
        text: Sentence of the card; "" without a stop.
    """

    def __init__(self, server: Any, listener: Listener):
        self._listener = listener
        self.card = server.gui.add_html("")
        self.mark = server.scene.add_icosphere("/stop", RADIUS_M, color=rgb("bad"), visible=False)
        self.text = ""

    def draw(self) -> None:
        """Show the latest answer of the black box, which may improve while the robot drives on."""
        message = self._listener.latest(ANSWER, Stop)
        # After the clock was set back, the answer belongs to another drive.
        if message is None or message.header.stamp > rospy.get_rostime():
            self.mark.visible = False
            self._write("")
            return
        self._write(message.sentence)
        frame_pose = self._listener.frame_pose(message.header.frame_id)
        self.mark.visible = frame_pose is not None
        if frame_pose is not None:
            x, y = transform_point(frame_pose, message.x, message.y)
            self.mark.position = (x, y, RADIUS_M)

    def _write(self, sentence: str) -> None:
        if sentence == self.text:
            return
        self.text = sentence
        if not sentence:
            self.card.content = ""
            return
        words = html.escape(sentence[0].upper() + sentence[1:])
        self.card.content = f'<div class="stop"><h2>Last stop</h2><p>{words}.</p></div>'
