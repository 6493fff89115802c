"""The ROS node viewer: a page in a browser with the robot, its planner and its parameters.

Started by scripts/viewer.py. While no page is open it subscribes to nothing.

Parameters: ~robot (jackal; name or folder of a description), ~map (whether it drives on a map), ~replay (whether a bag
is played by the node replay), ~tf_prefix, ~host
(127.0.0.1: which computers reach the page) and ~port (8080, or the next free one). Sets ~address, where the page is,
with the token without which every request is refused: a new one at each start, unless the environment variable
APPLR_VIEWER_TOKEN sets it.
"""

from __future__ import annotations

import html
import os
import time
from typing import Any, Dict

import rospy
from nav_msgs.msg import Odometry

from applr_ros1.common.arguments import frame_prefix, number_within
from applr_ros1.common.progress import Throttled
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.robots import JACKAL, Robot, load

from . import admission, panel, pilot, race, recording, scene, world
from .listening import Listener, by_hand
from .page import ACCENT, Page, sends
from .recording import FOLDER, PLAYED

RATE = 10.0  # Hz of wall time with a page open
IDLE = 0.2  # s between looks for a page
HINT = (
    "<b>Click on the ground: the robot drives there.</b> A slider makes you the one who sets its parameters.<br>"
    "Keys: G go, S stop, H hand over, V view."
)


class Viewer:
    """The page and what it shows, the same to everybody who looks, served on host and port, or the next free port.

    The names of the robot's frames begin with prefix; everything is drawn in the frame fixed. replay: whether a bag is
    played, and nothing can be driven.
    """

    def __init__(self, robot: Robot, prefix: str, fixed: str, host: str, port: int, replay: bool = False):
        import viser

        self._robot, self._replay, self.listener = robot, replay, Listener(fixed)
        token = admission.token()
        with admission.guarded(token, host):
            self.server = viser.ViserServer(host, port, label=f"applr_ros1: {robot.name}", verbose=False)
        self.address = f"http://{host}:{self.server.get_port()}/{token}/"
        gui, look = self.server.gui, {"show_logo": False, "show_share_button": False, "brand_color": ACCENT}
        gui.configure_theme(control_width="large", **look)  # type: ignore[arg-type]
        gui.main_panel.dock_right()  # the scene has the rest of the window
        self.pilot = pilot.Pilot(robot, self.listener, self.say)
        self.scene = scene.Scene(self.server, robot, self.listener, prefix + robot.frames.base)
        self._pages: Dict[Any, Page] = {}
        self._views: Dict[int, str] = {}  # by page, one of scene.VIEWS
        self._ready, self._leaving, self._now = False, "", 0.0
        tabs, self.text = gui.add_tab_group(), ""
        if replay:
            with tabs.add_tab("Replay"):
                self._recording = recording.Replay(gui, self.say)
        with tabs.add_tab("Drive"):
            self.panel = panel.Panel(gui, robot, self.listener, self.pilot, not replay)
        if not replay:
            with tabs.add_tab("World"):
                odom = prefix + robot.frames.odom
                self._world = world.WorldTab(gui, robot, self.listener, odom, self.say, self.restart)
            with tabs.add_tab("Race"):
                known = self.pilot, self._world, self.panel.methods, self.say
                self._race = race.RaceTab(self.server, robot, self.listener, *known)
            self.server.scene.on_click()(lambda event: self._world.clicked(event, self.scene.pose))
        with tabs.add_tab("View"):
            for name, layer in self.scene.layers.items():
                by_hand(gui.add_checkbox(name, layer.visible), lambda on, layer=layer: setattr(layer, "visible", on))
        self._bags = None
        if FOLDER in os.environ:
            with tabs.add_tab("Bags"):
                self._bags = recording.Bags(gui, os.environ[FOLDER], self.restart, replay, self.say)
        self._commands = self._add_commands()

    def _add_commands(self) -> Dict[str, Any]:
        """What the bar's buttons and the keys do."""
        work = {"view": ("V", self._turn)}
        if self._replay:
            work["play or pause"] = ("P", lambda _: self._recording.play())
        else:
            work["go"] = ("G", lambda _: self._world.drive_course())
            work["stop"] = ("S", lambda _: self._race.end())
            work["hand over"] = ("H", lambda _: self._hand_over())
        commands = {}
        for name, (key, call) in work.items():
            commands[name] = self.server.gui.add_command(name, hotkey=key)  # type: ignore[arg-type]
            commands[name].on_trigger(call)
        return commands

    def _hand_over(self) -> None:
        self.pilot.choose("applr" if self.pilot.method == pilot.HAND else pilot.HAND)

    def _turn(self, event: Any) -> None:
        """The next of scene.VIEWS for the page that asks."""
        views = list(scene.VIEWS)
        view = views[(views.index(self._views[event.client_id]) + 1) % len(views)]
        self._views[event.client_id] = view
        self.scene.look(event.client, view)

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
            if not self.server.get_clients() and not self._replay and not self._race.running.is_set():
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
        if rospy.get_time() < self._now:  # a bag that is played from an earlier time
            self.listener.close()
            self.scene.forget()
        self._now = rospy.get_time()
        odometry = self.listener.newest(self._robot.topics.odometry, Odometry)
        speed = odometry.twist.twist.linear.x if odometry is not None else 0.0
        goal = panel.goal_status(self.listener)
        driving = goal is not None and goal.status in panel.UNDER_WAY
        self.panel.look(speed, self.scene.clearance)
        if not self._replay and self._world.look():
            self.scene.forget()
            self.panel.forget()
        self.scene.draw(speed, driving)
        if self._bags is not None:
            self._bags.look()
        if self._replay:
            self._recording.look()
        elif self._race.look(self.scene.pose, goal):
            self.scene.begin_trail()
        self._write(goal, speed, driving)

    def _write(self, goal: Any, speed: float, driving: bool) -> None:
        """Bring the bar and the notice of every page up to date."""
        silence = [] if self._replay else self.panel.silence()
        parts = {"doing": self.panel.doing(goal), "speed": f"{speed if abs(speed) >= panel.STANDING else 0.0:.2f} m/s"}
        parts["who"] = f"parameters by {self.pilot.who}"
        parts["monitor"] = self.panel.monitor() if driving else ""  # it stops whatever has no command
        if self._replay:  # a bag may lack them
            parts["doing"] = parts["doing"] if goal is not None else ""
            parts["who"] = parts["who"] if self.pilot.method else ""
        self.text = "\n".join([*parts.values(), *silence])
        self._ready = self._ready or (self.scene.pose is not None and not silence)
        starts = "the recording" if self._replay else html.escape("; ".join(silence) or "where the robot is")
        notice = (
            ""
            if self._ready
            else f"<b>{html.escape(self._robot.name)} starts</b>, SECONDS s. Waiting for it: {starts}."
        )
        if self._ready:
            parts["trouble"] = "".join(silence[:1])
        state = "".join(f'<span class="{name}">{html.escape(part)}</span>' for name, part in parts.items())
        title = f"{self._robot.name}{'' if self._replay else ' in ' + self._world.name} - applr_ros1"
        common = {"state": state, "title": title, "notice": self._leaving or notice}
        clients = self.server.get_clients()
        self._pages = {key: self._pages.get(key) or Page(client) for key, client in clients.items()}
        for key, page in self._pages.items():
            view = self._views.setdefault(key, "behind")
            self.scene.follow(clients[key], view)
            page.show(**common, buttons=self._buttons(driving, view), hint="" if self._replay else HINT)

    def _buttons(self, driving: bool, view: str) -> str:
        """The bar's buttons as HTML. The accent is on what to press next."""
        if self._replay:
            shown = [("play or pause", self._recording.next, True)]
        else:
            hand = self.pilot.method == pilot.HAND
            shown = [("go", "Go", not driving)] if self._world.course else []
            shown += [("stop", "Stop", driving)]
            shown += [("hand over", "Hand back" if hand else "Take over", False)] if self.pilot.method else []
        shown += [("view", "View: " + view, False)]
        return "".join(
            f'<button {sends(self._commands[name])} data-key="{self._commands[name].hotkey}"'
            f"{' class=next' if accent else ''}>{label}</button>"
            for name, label, accent in shown
        )

    def restart(self, what: str, **values: str) -> bool:
        """Have ./applr play start anew with other launch arguments. False where it has not started this node."""
        words = rospy.get_param(PLAYED, None)
        if words is None:
            return False
        self._leaving = f"<b>{html.escape(what)} starts</b>, SECONDS s. This takes about half a minute."
        for page in self._pages.values():
            page.show(notice=self._leaving)
        self.server.flush()
        rospy.set_param(PLAYED, [*words, *(f"{name}:={value}" for name, value in values.items())])
        return True

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
    host, replay = str(rospy.get_param("~host", "127.0.0.1")), bool(rospy.get_param("~replay", False))
    viewer = Viewer(robot, prefix, fixed, host, port, replay)
    rospy.set_param("~address", viewer.address)
    rospy.loginfo("viewer: the page is at %s", viewer.address)
    with until_shutdown():
        viewer.spin()
    viewer.close()
    return 0
