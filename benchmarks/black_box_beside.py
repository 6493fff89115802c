"""Stops beside stacks of others: `python -m benchmarks.black_box_beside`.

Plays a move_base_flex, a move_base with TebLocalPlannerROS on a base that drives sideways, and one
before a mux. Each stop is a row: what the black box said of it.
"""

from __future__ import annotations

import math
import re
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Dict, List, NamedTuple

import numpy as np
import rospy
from genpy.message import fill_message_args, get_message_class

from applr_ros1.drives.columns import COLUMNS, GAVE_UP, Fields
from applr_ros1.robots import JACKAL, Robot
from applr_ros1.senses.standing import ACTIVE
from sim_bridge.lidar import Lidar
from tests.support.box import spawned
from tests.support.ros import RosMaster

RATE_HZ = 20
SPEED = 0.3  # [m/s]
STOPS_AT_S = 8.0  # time at which each stop begins [s]
LASTS_S = 22.0  # time that is played [s]
STRAFES_AT_S = 4.0  # time from which on the base beside TEB drives sideways [s]
AT_ONCE = 3  # number of stops that are played at one time
PLANNER = "TebLocalPlannerROS"
LASER = JACKAL.laser.model_copy(
    update={"beams": 72, "first_angle": -math.pi, "last_angle": math.radians(175.0)}
)
# What the laser sees of a room that is 20 m long and wide
WALLS = [(x, 0.0, 0.0, 0.1, 20.0) for x in (-10.0, 10.0)]
WALLS += [(0.0, y, 0.0, 20.0, 0.1) for y in (-10.0, 10.0)]
ROOM = Lidar(LASER, np.zeros((0, 3)), np.array(WALLS))
HELD = r"the base did not follow its commands of 0\.30 m/s"


class ForeignStop(NamedTuple):
    """Stop beside a stack.

    Attributes:
        stack: flex, omni or mux.
        name: What happens.
        right: Regular expression of a right answer; "" if the robot does not stop.
        command: Topic of move_base's commands.
        actions: Actions with a goal.
    """

    stack: str
    name: str
    right: str
    command: str = "/cmd_vel"
    actions: str = ""


STOPS = (
    ForeignStop("flex", "laser silent", "no scan for", actions="move_base exe_path"),
    ForeignStop("flex", "no path", "finds no path", actions="move_base get_path"),
    ForeignStop("flex", "base held", HELD, actions="exe_path"),
    ForeignStop("flex", "goal given up", "gave up its goal", actions="move_base exe_path"),
    ForeignStop("flex", "pause between goals", "", actions="exe_path"),
    ForeignStop("omni", "laser silent", "no scan for"),
    ForeignStop("omni", "base held", HELD),
    ForeignStop("omni", "odometry silent", "was not heard of"),
    ForeignStop("omni", "drives on sideways", ""),
    ForeignStop("mux", "locked", "does not reach the base", command="/move_base/cmd_vel"),
    # One node plays both, so that the box does not know whose silence it hears.
    ForeignStop("mux", "locked, one topic known", "no command came for", command="/nav_vel"),
)


# -- the stack -------------------------------------------------------------------------------------
class Header(NamedTuple):
    """Sender of messages that are stamped now, in frames of the robot."""

    robot: Robot = JACKAL
    frame: str = "odom"

    def header(self, time: float, frame: str) -> Fields:
        """Return a std_msgs/Header of this moment."""
        return {"stamp": rospy.get_rostime().to_nsec(), "frame_id": frame}


class ForeignStack:
    """Plays what the nodes of a stack publish, in the node move_base or move_base_flex."""

    def __init__(self, stop: ForeignStop):
        self._stop = stop
        self._x = 0.0
        self._y = 0.0
        costmap = {"robot_base_frame": "base_link", "global_frame": "odom"}
        layer = {"observation_sources": "scan", "scan": {"topic": "/scan"}}
        parameters: Dict[str, Any] = {
            "local_costmap": {**costmap, **layer},
            "controller_frequency": 10.0,
            PLANNER: {"max_vel_x": SPEED, "max_vel_theta": 1.0},
        }
        planner_type = f"teb_local_planner/{PLANNER}"
        self._actions = [""]
        if stop.stack == "flex":
            parameters["controllers"] = [{"name": PLANNER, "type": planner_type}]
            self._actions = ["move_base/", "exe_path/", "get_path/"]
        else:
            parameters["base_local_planner"] = planner_type
        for name, value in parameters.items():
            rospy.set_param(f"~{name}", value)
        keys = {
            "/odom": "odometry",
            "/scan": "scans",
            "/cmd_vel": "commands",
            stop.command: "commands",
            f"~{PLANNER}/global_plan": "plans",
            "~NavfnROS/plan": "routes",
            f"~{self._actions[0]}result": "results",
        }
        for action in self._actions:
            keys[f"~{action}status"] = "goals"
        self._publishers = {}
        for topic, key in keys.items():
            message_class = get_message_class(COLUMNS[key].type.replace("/msg/", "/"))
            publisher = rospy.Publisher(topic, message_class, queue_size=5)
            self._publishers[topic] = (key, publisher)
        for topic in ("/odom", "/scan"):
            rospy.Subscriber(topic, self._publishers[topic][1].data_class, lambda message: None)

    def play(self) -> None:
        """Publish until the end."""
        rate = rospy.Rate(RATE_HZ)
        for tick in range(round(LASTS_S * RATE_HZ)):
            self._tick(tick, tick / RATE_HZ)
            rate.sleep()

    def _tick(self, tick: int, seconds: float) -> None:
        """Publish the messages of a time [s]."""
        is_over = seconds >= STOPS_AT_S
        # What happens from now on
        happens = self._stop.name if is_over else ""
        strafes = self._stop.stack == "omni" and seconds >= STRAFES_AT_S
        asked = {"twist": (0.0, 0.0) if strafes else (SPEED, 0.0), "sideways": SPEED * strafes}
        drives = happens in ("", "drives on sideways", "goal given up", "odometry silent")
        self._x += drives * asked["twist"][0] / RATE_HZ
        self._y += drives * asked["sideways"] / RATE_HZ
        has_goal = happens not in ("goal given up", "pause between goals")
        if happens != "odometry silent":
            measured = asked if drives else {"twist": (0.0, 0.0)}
            self._send("/odom", stamp=0, pose=(self._x, self._y, 0.0), **measured)
        if tick % 2 == 0 and has_goal and happens != "no path":
            self._send(self._stop.command, **asked)
            is_locked = is_over and self._stop.stack == "mux"
            if self._stop.command != "/cmd_vel" and not is_locked:
                self._send("/cmd_vel", **asked)
        if tick % 4 == 0:
            if happens != "laser silent":
                ranges = ROOM.scan(self._x, self._y, 0.0).tolist()
                self._send("/scan", stamp=0, fan=LASER.fan, ranges=ranges)
            for action in self._actions:
                is_pursued = has_goal and action.rstrip("/") in self._stop.actions.split(" ")
                self._send(f"~{action}status", not is_pursued, id=f"{action} one", code=ACTIVE)
        if happens == "goal given up" and tick == STOPS_AT_S * RATE_HZ:
            action = self._actions[0]
            self._send(f"~{action}result", id=f"{action} one", code=GAVE_UP)
        if tick % 10 == 0 and has_goal:
            # To a goal 5 m away
            path = [(self._x + 0.1 * step, self._y, 0.0) for step in range(50)]
            if happens == "no path":
                path = []
            else:
                self._send(f"~{PLANNER}/global_plan", path=path)
            self._send("~NavfnROS/plan", path=path)

    def _send(self, topic: str, is_empty: bool = False, **row: Any) -> None:
        """Publish a row of a drive, or a message without any."""
        key, publisher = self._publishers[topic]
        message = publisher.data_class()
        if not is_empty:
            fill_message_args(message, [COLUMNS[key].pack({"time": 0.0, **row}, Header())])
        publisher.publish(message)


# -- the rows --------------------------------------------------------------------------------------
def row_of(stop: ForeignStop) -> List[str]:
    """Play a stop beside the black box, and return stack, stop, whether it is right, and words."""
    with RosMaster() as master, tempfile.TemporaryDirectory() as folder:
        box = spawned(master, folder)
        box.until("waiting for")
        number = STOPS.index(stop)
        stack = master.spawn(sys.executable, "-m", "benchmarks.black_box_beside", str(number))
        stack.process.wait(10 * LASTS_S)
        time.sleep(1.0)
        answers = re.findall(r"\[WARN\].*?: black box: (.*)", box.text)
        found = re.findall(r"black box: (the robot .*)", box.text)
        words = [*found, *answers][-1] if found else "no stop"
        # An answer is right, or says nothing of a cause.
        is_right = bool(re.search(stop.right, words)) if stop.right else not found
        return [stop.stack, stop.name, str(is_right), words]


def main() -> int:
    """Print a row for each stop, or play the stack of one."""
    if len(sys.argv) > 1:
        stop = STOPS[int(sys.argv[1])]
        rospy.init_node("move_base_flex" if stop.stack == "flex" else "move_base")
        ForeignStack(stop).play()
        return 0
    with ThreadPoolExecutor(AT_ONCE) as executor:
        for row in executor.map(row_of, STOPS):
            print(*row, sep=" | ", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
