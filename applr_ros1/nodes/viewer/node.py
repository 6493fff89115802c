"""The ROS node viewer: a page in a browser with the robot, its planner and its parameters.

Started by scripts/viewer.py. While no page is open it subscribes to nothing.

Parameters: ~robot (jackal; name or folder of a description), ~map (whether it drives on a map), ~tf_prefix, ~host
(127.0.0.1: which computers reach the page) and ~port (8080, or the next free one). Sets ~address, where the page is,
with the token without which every request is refused: a new one at each start, unless the environment variable
APPLR_VIEWER_TOKEN sets it.
"""

from __future__ import annotations

import html
import time
from typing import Any, Dict

import rospy
from nav_msgs.msg import Odometry

from applr_ros1.common.arguments import frame_prefix, number_within
from applr_ros1.common.progress import Throttled
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.robots import JACKAL, Robot, load

from . import admission, panel, pilot, race, scene, world
from .listening import Listener, by_hand
from .page import ACCENT, Page, sends

RATE = 10.0  # Hz of wall time with a page open
IDLE = 0.2  # s between looks for a page
HINT = (
    "<b>Click on the ground: the robot drives there.</b> A slider makes you the one who sets its parameters.<br>"
    "Keys: G go, S stop, H hand over, V view."
)
STARTS = "The first start on a computer compiles kernels, about a minute. "


class Viewer:
    """The page and what it shows, the same to everybody who looks, served on host and port, or the next free port.

    The names of the robot's frames begin with prefix; everything is drawn in the frame fixed.
    """

    def __init__(self, robot: Robot, prefix: str, fixed: str, host: str, port: int):
        import viser

        self._robot, self.listener = robot, Listener(fixed)
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
        self._ready, self._now, self._moved = False, 0.0, 0.0
        tabs, self.text = gui.add_tab_group(), ""
        with tabs.add_tab("Drive"):
            self.panel = panel.Panel(gui, robot, self.listener, self.pilot)
        with tabs.add_tab("World"):
            self._world = world.WorldTab(gui, robot, self.listener, prefix + robot.frames.odom, self.say)
        with tabs.add_tab("Race"):
            self._race = race.RaceTab(self.server, self._world, self.pilot, self.panel.methods)
        self.server.scene.on_click()(lambda event: self._world.clicked(event, self.scene.pose))
        with tabs.add_tab("View"):
            for name, layer in self.scene.layers.items():
                by_hand(gui.add_checkbox(name, layer.visible), lambda on, layer=layer: setattr(layer, "visible", on))
        works: Dict[str, Any] = {  # of the bar's buttons and the keys
            "view": ("V", self._turn),
            "go": ("G", lambda _: self._world.drive_course()),
            "stop": ("S", lambda _: self._race.end()),
            "hand over": ("H", lambda _: self.pilot.choose("applr" if self._by_hand else pilot.HAND)),
        }
        self._commands = {name: gui.add_command(name, hotkey=key) for name, (key, _) in works.items()}
        for name, (_, work) in works.items():
            self._commands[name].on_trigger(work)

    @property
    def _by_hand(self) -> bool:
        return self.pilot.method == pilot.HAND

    def _turn(self, event: Any) -> None:
        """The next of scene.VIEWS for the page that asks."""
        page, views = self._pages[event.client_id], list(scene.VIEWS)
        page.view = views[(views.index(page.view) + 1) % len(views)]
        self.scene.look(page.client, page.view)

    def say(self, text: str) -> None:
        """Show one line to everybody who looks."""
        rospy.loginfo("viewer: %s", text)
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
        if rospy.get_time() < self._now:  # the clock began anew
            self.listener.close()
            self.scene.forget()
        if rospy.get_time() != self._now:
            self._now, self._moved = rospy.get_time(), time.monotonic()
        odometry = self.listener.newest(self._robot.topics.odometry, Odometry)
        speed = odometry.twist.twist.linear.x if odometry is not None else 0.0
        goal = panel.goal_status(self.listener)
        driving = goal is not None and goal.status in panel.UNDER_WAY
        self.panel.look(speed, self.scene.clearance)
        if self._world.look():
            self.scene.forget()
            self.panel.forget()
        self.scene.draw(speed, driving)
        if self._race.look(self.scene.pose, goal):
            self.scene.begin_trail()
        self._write(goal, speed, driving)

    def _write(self, goal: Any, speed: float, driving: bool) -> None:
        """Bring the bar and the notice of every page up to date."""
        silence = self.panel.silence()
        if self._ready and time.monotonic() - self._moved > panel.SILENT:
            silence.insert(0, "the clock stands still")
        parts = {"doing": self.panel.doing(goal)}
        parts["speed"] = f"{speed if abs(speed) >= panel.STANDING else 0.0:.2f} m/s"
        parts["who"] = f"parameters by {self.pilot.who}"
        parts["monitor"] = self.panel.monitor() if driving else ""  # it stops whatever has no command
        self.text, notice = "\n".join([*parts.values(), *silence]), ""
        self._ready = self._ready or (self.scene.pose is not None and not silence)
        if self._ready:
            parts["trouble"] = "".join(silence[:1])
        else:
            missing = ", ".join(line.split(":")[0] for line in silence) or "no transform of the robot"
            notice = f"<b>{html.escape(self._robot.name)} starts</b>, SECONDS s. {STARTS}"
            notice += f"So far: {html.escape(missing)}."
        world = self._world.name
        common = {"notice": notice, "hint": HINT}
        common["title"] = f"{self._robot.name}{' in ' * bool(world)}{world} - applr_ros1"
        common["legend"] = self._race.legend if self.scene.layers["ghosts"].visible else ""
        common["state"] = "".join(f'<span class="{name}">{html.escape(part)}</span>' for name, part in parts.items())
        clients = self.server.get_clients()
        self._pages = {key: self._pages.get(key) or Page(client) for key, client in clients.items()}
        for page in self._pages.values():
            self.scene.follow(page.client, page.view)
            page.show(**common, buttons=self._buttons(driving, page.view))

    def _buttons(self, driving: bool, view: str) -> str:
        """The bar's buttons as HTML. The accent is on what to press next."""
        labels: Dict[str, Any] = {}
        labels["go"] = "Go" if self._world.course else "", not driving
        labels["stop"] = "Stop", driving
        labels["hand over"] = "Hand back" if self._by_hand else "Take over" if self.pilot.method else "", False
        labels["view"] = "View: " + view, False
        return "".join(
            f'<button {sends(self._commands[name])} data-key="{self._commands[name].hotkey}"'
            f"{' class=next' if accent else ''}>{label}</button>"
            for name, (label, accent) in labels.items()
            if label
        )

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
