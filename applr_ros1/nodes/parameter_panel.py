"""The node parameter_panel: time, speed and planner parameters as a picture, which RViz shows beside its view.

Started by the launch files together with RViz, live and for a replayed bag. A text in RViz's view would cover the
course. Nothing is drawn while nobody subscribes.

Subscribes: applr/parameters, the robot's odometry, collision_monitor/action. Publishes: ~image, at most 5 Hz.
Parameter: ~robot (jackal), the name or the folder of its description, for the bounds and the odometry's name.
"""

from __future__ import annotations

import time
from typing import Dict, Tuple

import numpy as np
import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image
from std_msgs.msg import String

from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.msg import Parameters
from applr_ros1.nodes.viewer.listening import Listener
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from applr_ros1.robots import JACKAL, Robot, load

WIDTH, HEIGHT = 400, 280  # pixels; RViz shows it in a pane of about this shape; many parameters make it higher
TOP, LINE, GAP, ROW = 6, 21, 8, 22  # pixels: above the lines, of a line, below the lines, of a parameter
VALUES, BARS = 205, 220  # where the column of values ends and where the bars begin
RATE = 5.0  # Hz of wall time
PAPER, INK, FAINT, BAR, DEFAULT = "#303030", "#ffffff", "#808080", "#4a90d9", "#ffc800"


def picture(parameters: Dict[str, float], lines: Tuple[str, ...], space: Space = SPACE) -> np.ndarray:
    """The panel as (height, width, 3) uint8.

    Args:
        parameters: {name: value}; a bar shows the place of each value between the parameter's bounds, a mark on it
            the default.
        lines: What stands above the parameters.
        space: Bounds and defaults of the robot's parameters.
    """
    from PIL import Image as Pictures
    from PIL import ImageDraw, ImageFont

    height = max(HEIGHT, TOP + LINE * len(lines) + GAP + ROW * len(parameters) + TOP)
    image = Pictures.new("RGB", (WIDTH, height), PAPER)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(15)
    bounds = {name: row for name, *row in zip(space.names, space.low, space.high, space.theta0)}
    right, top = WIDTH - 12, TOP
    for line in lines:
        pen.text((12, top), line, fill=INK, font=font)
        top += LINE
    top += GAP
    for name, value in parameters.items():
        pen.text((12, top), name, fill=INK, font=font)
        pen.text((VALUES, top), f"{value:.3g}", fill=INK, font=font, anchor="ra")
        if name in bounds:
            low, high, default = bounds[name]
            x, mark = (BARS + (right - BARS) * (v - low) / (high - low) for v in (value, default))
            pen.rectangle((BARS, top + 4, right, top + 14), outline=FAINT)
            pen.rectangle((BARS, top + 4, max(BARS, min(x, right)), top + 14), fill=BAR)
            pen.line((mark, top + 1, mark, top + 17), fill=DEFAULT, width=2)
        top += ROW
    pen.text((right, 6), "| default", fill=DEFAULT, font=font, anchor="ra")
    return np.asarray(image)


class ParameterPanel:
    """Keeps the newest message of each topic and draws what changed, for one robot."""

    def __init__(self, robot: Robot = JACKAL) -> None:
        self._space, self._odometry = space_of(robot), robot.topics.odometry
        self._listener = Listener(robot.frames.odom)
        self._image = rospy.Publisher("~image", Image, queue_size=1)

    def spin(self) -> None:
        """Draw until shutdown."""
        while not rospy.is_shutdown():
            if self._image.get_num_connections():
                self._image.publish(self._message())
            time.sleep(1.0 / RATE)  # of wall time: the clock of a replayed bag may stand

    def _message(self) -> Image:
        newest = self._listener.newest
        parameters, odometry = newest("applr/parameters", Parameters), newest(self._odometry, Odometry)
        action = newest("collision_monitor/action", String)
        values = {} if parameters is None else dict(zip(parameters.names, parameters.values))
        speed = "no odometry" if odometry is None else f"speed {odometry.twist.twist.linear.x:.2f} m/s"
        commands = "no monitor" if action is None else action.data.partition(":")[0]
        lines = f"time {rospy.get_time():.1f} s    {speed}", f"commands: {commands}"
        pixels = picture(values, lines, self._space)
        height, width, _ = pixels.shape
        message = Image(height=height, width=width, encoding="rgb8", step=3 * width, data=pixels.tobytes())
        message.header.stamp = rospy.get_rostime()
        return message


def main() -> int:
    """Runs until shutdown. Raises ApplrError, one line, where ~robot is none."""
    init_node("parameter_panel")
    panel = ParameterPanel(load(str(rospy.get_param("~robot", JACKAL.name))))
    with until_shutdown():
        panel.spin()
    return 0
