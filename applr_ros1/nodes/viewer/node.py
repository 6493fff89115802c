"""ROS node `viewer`: a web page with the robot, its planner and its parameters.

Started as `rosrun applr_ros1 viewer.py`. The node has no subscriptions while no page is open.

Parameters: ~robot (jackal; name or folder of a description), ~map (whether the robot drives on a
map), ~tf_prefix and ~port (8080, or the next free one). The page is served on 127.0.0.1. The node
sets ~address to the page's address, with the token that every request needs. The token is new at
each start unless APPLR_VIEWER_TOKEN sets it.
"""

from __future__ import annotations

import html
import math
import time
from functools import partial
from typing import Any, Sequence

import rospy
from actionlib_msgs.msg import GoalID
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry

from applr_ros1.common.arguments import number_within
from applr_ros1.common.pages.colors import rgb
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.nodes.conversions import pose_stamped
from applr_ros1.nodes.robot_parameters import named_robot
from applr_ros1.nodes.sensors import RosClock
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import SILENT_ON_PAGE_S, STANDS, UNDER_WAY

from . import admission, look, panel, scene
from .listening import Listener, by_hand, publish
from .stop_card import StopCard

RATE_HZ = 10.0  # frame rate while a page is open, in wall time [Hz]
IDLE_S = 0.2  # interval between checks for an open page [s]
HOST = "127.0.0.1"
LEGEND = look.legend(
    ("square", "brand", "robot, with an arrow to its front"),
    ("square", "obstacle", "obstacle of the simulator"),
    ("", "mover", "moving obstacle"),
    ("", "slow", "scan"),
    ("square", "part-5", "costmap near obstacles"),
    ("square", "fast", "where the robot would touch"),
    ("line", "line", "global plan"),
    ("line costs", look.CHEAP, "trajectories, cheap to dear"),
    ("line", "goal", "trajectory of the lowest cost"),
    ("", "goal", "goal"),
    ("", "bad", "last stop"),
)
CLICK = "a click on the ground is the next goal"
HINT = "Cancel all goals (key S)."
STARTS = "starting: the first start on a computer compiles code, which takes about a minute"


class Viewer:
    """Web page, shared by all clients.

    Args:
        robot: Description of the robot.
        prefix: Prefix of the robot's frames.
        fixed: Frame in which everything is drawn.
        port: Port of the page; the next free one is used if it is taken.
    """

    def __init__(self, robot: Robot, prefix: str, fixed: str, port: int):
        import viser

        self._robot = robot
        self.listener = Listener(fixed)
        token = admission.token()
        page_title = f"applr_ros1: {robot.name}"
        with admission.guarded(token, partial(look.dressed, title=page_title)):
            self.server = viser.ViserServer(HOST, port, label=page_title, verbose=False)
        self.address = f"http://{HOST}:{self.server.get_port()}/{token}/"
        gui = self.server.gui
        gui.configure_theme(
            control_width="large",
            show_logo=False,
            show_share_button=False,
            brand_color=rgb("brand"),
        )
        gui.main_panel.dock_right()  # The scene fills the rest of the window.
        self.scene = scene.ViewerScene(
            self.server, robot, self.listener, prefix + robot.frames.base
        )
        self._is_ready = False  # whether everything has answered once since the start
        self._clock = RosClock()
        self._goal = rospy.Publisher("move_base_simple/goal", PoseStamped, queue_size=1)
        self._cancel = rospy.Publisher("move_base/cancel", GoalID, queue_size=1)
        self._status = gui.add_html("")
        self.text = ""
        gui.add_button("Stop", hint=HINT).on_click(lambda _: self.stop())
        gui.add_command("Stop", hotkey="S").on_trigger(lambda _: self.stop())
        self.stop_card = StopCard(self.server, self.listener)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            self.panel = panel.Panel(gui, robot, self.listener, self.report)
        with tabs.add_tab("Legend and view"):
            gui.add_html(LEGEND)
            for layer_name, layer in self.scene.layers.items():
                checkbox = gui.add_checkbox(layer_name, layer.visible)
                by_hand(checkbox, partial(setattr, layer, "visible"))
        self.server.scene.on_click()(self.clicked)

    def clicked(self, ray: Any) -> None:
        """Send a goal at the point on the ground that a click's ray hits.

        Its heading is that of the way from the robot to it.
        """
        eye_x, eye_y, eye_z = ray.ray_origin
        dx, dy, dz = ray.ray_direction
        if dz >= -1e-3:
            return  # The ray points above the horizon.
        goal_x = eye_x - eye_z / dz * dx
        goal_y = eye_y - eye_z / dz * dy
        goal_yaw = 0.0
        if self.scene.pose is not None:
            robot_x, robot_y, _ = self.scene.pose
            goal_yaw = math.atan2(goal_y - robot_y, goal_x - robot_x)
        goal_pose = (goal_x, goal_y, goal_yaw)
        goal = pose_stamped(goal_pose, self.listener.fixed, rospy.Time.now())
        publish(self.report, self._goal, goal)

    def stop(self) -> None:
        """Cancel all goals."""
        publish(self.report, self._cancel, GoalID())

    def report(self, text: str) -> None:
        """Show one line to all clients."""
        rospy.loginfo("viewer: %s", text)
        for client in self.server.get_clients().values():
            client.add_notification("applr_ros1", text, auto_close_seconds=8.0, color="orange")

    def spin(self) -> None:
        """Draw until shutdown, at RATE_HZ while a page is open."""
        while not rospy.is_shutdown():
            next_frame_time = time.monotonic() + 1.0 / RATE_HZ
            if not self.server.get_clients():
                self.listener.close()
                time.sleep(IDLE_S)
                continue
            try:
                with self.server.atomic():
                    self.draw()
            except Exception as problem:  # The page must survive a message that cannot be drawn.
                rospy.logerr_throttle(10.0, f"viewer: {type(problem).__name__}: {problem}")
            time.sleep(max(0.0, next_frame_time - time.monotonic()))

    def draw(self) -> None:
        """Update the page."""
        if self._clock.went_back():
            self.listener.close()
            self.scene.forget()
        odometry = self.listener.latest(self._robot.topics.odometry, Odometry)
        speed = 0.0
        if odometry is not None:
            linear = odometry.twist.twist.linear
            speed = math.copysign(math.hypot(linear.x, linear.y), linear.x)
        goal_status = panel.goal_status(self.listener)
        is_driving = goal_status is not None and goal_status.status in UNDER_WAY
        self.panel.show_state()
        self.scene.draw(is_driving)
        self.stop_card.draw()
        for client in self.server.get_clients().values():
            self.scene.follow(client)
        self._write_status(goal_status, speed, is_driving)

    def _write_status(self, goal: Any, speed: float, is_driving: bool) -> None:
        """Update the lines above the tabs."""
        # Until everything has answered once, the clock of a simulator may not have started.
        silence = self.panel.silence()
        if self._is_ready and self._clock.stands(SILENT_ON_PAGE_S):
            silence.insert(0, "the clock has stopped")
        self._is_ready = self._is_ready or (self.scene.pose is not None and not silence)
        problems = silence
        if not silence and self.panel.trouble:
            problems = [self.panel.trouble]

        if abs(speed) < STANDS.v:
            speed = 0.0  # The noise of the odometry would make the line flicker.
        activity = f"{self.panel.doing(goal)}, {speed:.2f} m/s".replace("-", "−")
        notes = [f"parameters by {self.panel.source}"]
        if is_driving:  # Without commands, the monitor always reports a stop.
            notes.append(self.panel.monitor())
        else:
            notes.append(CLICK)
        if not self._is_ready:
            notes.append(STARTS)

        status_text = "\n".join([activity, *notes, *problems])
        if status_text == self.text:
            return
        self.text = status_text
        self._status.content = (
            '<div class="status">'
            + _paragraphs("verdict", [activity])
            + _paragraphs("note", notes)
            + _paragraphs("bad", problems)
            + "</div>"
        )

    def close(self) -> None:
        """Close the page."""
        self.listener.close()
        self.server.stop()


def _paragraphs(style: str, lines: Sequence[str]) -> str:
    """Return lines as paragraphs of a class of words.css."""
    return "".join(f'<p class="{style}">{html.escape(line)}</p>' for line in lines)


def main() -> int:
    """Run the node until shutdown.

    Raises:
        ApplrError: A parameter is invalid.
    """
    init_node("viewer")
    parameters = rospy.get_param("~", {})
    robot, prefix = named_robot(parameters)
    # All robots share the frame of the map, so that it has no prefix.
    fixed_frame = prefix + robot.frames.odom
    if parameters.get("map"):
        fixed_frame = robot.frames.map
    port = int(number_within("port", parameters.get("port", 8080), 1, 65535))
    viewer = Viewer(robot, prefix, fixed_frame, port)
    rospy.set_param("~address", viewer.address)
    rospy.loginfo("viewer: the page is at %s", viewer.address)
    with until_shutdown():
        viewer.spin()
    viewer.close()
    return 0
