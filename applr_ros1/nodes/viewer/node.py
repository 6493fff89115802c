"""The ROS node viewer: a page in a browser with the robot, its planner and its parameters.

Started by scripts/viewer.py. While no page is open it subscribes to nothing.

Parameters: ~robot (jackal; name or folder of a description), ~map (whether it drives on a map), ~tf_prefix, ~host
(127.0.0.1: which computers reach the page) and ~port (8080, or the next free one). Sets ~address, where the page is,
with the token without which every request is refused: a new one at each start, unless the environment variable
APPLR_VIEWER_TOKEN sets it.
"""

from __future__ import annotations

import time

import rospy

from applr_ros1.common.arguments import frame_prefix, number_within
from applr_ros1.common.progress import Throttled
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.robots import JACKAL, Robot, load

from . import admission, panel, pilot, race, scene, world
from .listening import Listener, by_hand

RATE = 10.0  # Hz of wall time with a page open
IDLE = 0.2  # s between looks for a page


class Viewer:
    """The page and what it shows, the same to everybody who looks, served on host and port, or the next free port.

    The names of the robot's frames begin with prefix; everything is drawn in the frame fixed.
    """

    def __init__(self, robot: Robot, prefix: str, fixed: str, host: str, port: int):
        import viser

        self.listener = Listener(fixed)
        token = admission.token()
        with admission.guarded(token, host):
            self.server = viser.ViserServer(host, port, label=f"applr_ros1: {robot.name}", verbose=False)
        self.address = f"http://{host}:{self.server.get_port()}/{token}/"
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        self.pilot = pilot.Pilot(robot, self.listener, self.say)
        self.scene = scene.Scene(self.server, robot, self.listener, prefix + robot.frames.base)
        gui = self.server.gui
        self.state = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            self.panel = panel.Panel(gui, robot, self.listener, self.pilot)
        with tabs.add_tab("World"):
            self._world = world.WorldTab(gui, robot, self.listener, prefix + robot.frames.odom, self.say)
        with tabs.add_tab("Race"):
            methods = self.panel.methods
            self._race = race.RaceTab(self.server, robot, self.listener, self.pilot, self._world, methods)
        with tabs.add_tab("View"):
            self._follow = gui.add_checkbox("follow the robot", True)
            for text, above in (("from above", True), ("from behind", False)):
                button = gui.add_button(text)
                button.on_click(lambda event, above=above: event.client and self.scene.look(event.client, above))
            for name, layer in self.scene.layers.items():
                by_hand(gui.add_checkbox(name, layer.visible), lambda on, layer=layer: setattr(layer, "visible", on))
        self.server.on_client_connect(lambda client: self.scene.look(client, False))
        self.server.scene.on_click()(lambda event: self._world.clicked(event, self.scene.pose))

    def say(self, text: str) -> None:
        """Show one line to everybody who looks."""
        rospy.logwarn("viewer: %s", text)
        for client in self.server.get_clients().values():
            client.add_notification("applr_ros1", text, auto_close_seconds=8.0, color="orange")

    def spin(self) -> None:
        """Draw until shutdown, at RATE while a page is open."""
        report = Throttled(rospy.logerr)
        while not rospy.is_shutdown():
            began = time.monotonic()
            if not self.server.get_clients() and not self._race.running.is_set():
                self.listener.close()
                time.sleep(IDLE)
                continue
            try:
                with self.server.atomic():
                    self.draw()
            except Exception as problem:  # one message that cannot be drawn does not end the page
                report(f"viewer: {type(problem).__name__}: {problem}")
            time.sleep(max(0.0, began + 1.0 / RATE - time.monotonic()))

    def draw(self) -> None:
        """Bring the page up to date."""
        self.state.content = self.panel.look()
        self._world.look()
        self.scene.draw(self.panel.speed)
        if self._race.look(self.scene.pose):
            self.scene.begin_trail()
        if self._follow.value:
            for client in self.server.get_clients().values():
                self.scene.follow(client)

    def close(self) -> None:
        """End the page."""
        self.listener.close()
        self.pilot.close()
        self.server.stop()


def main() -> int:
    """Runs until shutdown. Raises ApplrError, one line, for parameters that cannot be used."""
    init_node("viewer")
    robot = load(str(rospy.get_param("~robot", JACKAL.name)))
    prefix = frame_prefix(str(rospy.get_param("~tf_prefix", "")))
    fixed = robot.frames.map if rospy.get_param("~map", False) else prefix + robot.frames.odom
    port = int(number_within("port", rospy.get_param("~port", 8080), 1, 65535))
    viewer = Viewer(robot, prefix, fixed, str(rospy.get_param("~host", "127.0.0.1")), port)
    rospy.set_param("~address", viewer.address)
    rospy.loginfo("viewer: the page is at %s", viewer.address)
    with until_shutdown():
        viewer.spin()
    viewer.close()
    return 0
