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

import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped, Twist, Vector3
from move_base_msgs.msg import MoveBaseActionResult
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan

from tests.support.ros import RosMaster

RATE_HZ = 20
SPEED = 0.3  # [m/s]
STOPS_AT_S = 8.0  # time at which each stop begins [s]
LASTS_S = 22.0  # time that is played [s]
STRAFES_AT_S = 4.0  # time from which on the base beside TEB drives sideways [s]
AT_ONCE = 3  # number of stops that are played at one time
PLANNER = "TebLocalPlannerROS"
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
class ForeignStack:
    """Plays what the nodes of a stack publish, in the node move_base or move_base_flex."""

    def __init__(self, stop: ForeignStop):
        self._stop = stop
        self._x = 0.0
        self._y = 0.0
        root = rospy.get_name()
        costmap = {"robot_base_frame": "base_link", "global_frame": "odom"}
        layer = {"observation_sources": "scan", "scan": {"topic": "/scan"}}
        parameters: Dict[str, Any] = {
            "local_costmap": {**costmap, **layer},
            "controller_frequency": 10.0,
            PLANNER: {"max_vel_x": SPEED, "max_vel_theta": 1.0},
        }
        planner_type = f"teb_local_planner/{PLANNER}"
        if stop.stack == "flex":
            parameters["controllers"] = [{"name": PLANNER, "type": planner_type}]
        else:
            parameters["base_local_planner"] = planner_type
        for name, value in parameters.items():
            rospy.set_param(f"~{name}", value)
        types: Dict[str, Any] = {
            "/odom": Odometry,
            "/scan": LaserScan,
            "/cmd_vel": Twist,
            stop.command: Twist,
            f"{root}/{PLANNER}/global_plan": Path,
            f"{root}/NavfnROS/plan": Path,
        }
        self._actions = ["move_base", "exe_path", "get_path"] if stop.stack == "flex" else [""]
        for action in self._actions:
            types[f"{root}/{action}/status".replace("//", "/")] = GoalStatusArray
        self._result = f"{root}/{self._actions[0]}/result".replace("//", "/")
        types[self._result] = MoveBaseActionResult
        self._publishers = {}
        for topic, message_type in types.items():
            self._publishers[topic] = rospy.Publisher(topic, message_type, queue_size=5)
        rospy.Subscriber("/odom", Odometry, lambda message: None)
        rospy.Subscriber("/scan", LaserScan, lambda message: None)

    def play(self) -> None:
        """Publish until the end."""
        rate = rospy.Rate(RATE_HZ)
        for tick in range(round(LASTS_S * RATE_HZ)):
            self._tick(tick, tick / RATE_HZ)
            rate.sleep()

    def _tick(self, tick: int, seconds: float) -> None:
        """Publish the messages of a time [s]."""
        name = self._stop.name
        is_over = seconds >= STOPS_AT_S
        # The velocity that is asked for, and that of the base
        strafes = self._stop.stack == "omni" and seconds >= STRAFES_AT_S
        asked = (0.0, SPEED) if strafes else (SPEED, 0.0)
        drives = not is_over or name in ("drives on sideways", "goal given up", "odometry silent")
        v, leftward = asked if drives else (0.0, 0.0)
        self._x += v / RATE_HZ
        self._y += leftward / RATE_HZ

        if not (is_over and name == "odometry silent"):
            odometry = Odometry(child_frame_id="base_link")
            self._stamp(odometry)
            odometry.pose.pose.position.x = self._x
            odometry.pose.pose.position.y = self._y
            odometry.pose.pose.orientation.w = 1.0
            odometry.twist.twist.linear = Vector3(v, leftward, 0.0)
            self._send("/odom", odometry)
        has_goal = not is_over or name not in ("goal given up", "pause between goals")
        if tick % 2 == 0 and has_goal and not (is_over and name == "no path"):
            self._command(asked, is_over)
        if tick % 4 == 0:
            self._sense(seconds)
            self._report(has_goal)
        if is_over and name == "goal given up" and tick == STOPS_AT_S * RATE_HZ:
            status = GoalStatus(GoalID(id=f"{self._actions[0]} one"), GoalStatus.ABORTED, "")
            self._send(self._result, MoveBaseActionResult(status=status))
        if tick % 10 == 0 and has_goal:
            self._plan(is_over and name == "no path")

    def _command(self, asked: Any, is_over: bool) -> None:
        """Publish the planner's command, and that of a mux unless it is locked."""
        v, leftward = asked
        command = Twist(linear=Vector3(v, leftward, 0.0))
        self._send(self._stop.command, command)
        is_locked = is_over and self._stop.stack == "mux"
        if self._stop.command != "/cmd_vel" and not is_locked:
            self._send("/cmd_vel", command)

    def _sense(self, seconds: float) -> None:
        """Publish a scan of a room that is 20 m long, unless the laser is silent."""
        if seconds >= STOPS_AT_S and self._stop.name == "laser silent":
            return
        scan = LaserScan(range_min=0.1, range_max=30.0, angle_min=-math.pi)
        self._stamp(scan, "base_link")
        scan.angle_increment = math.radians(5.0)
        for beam in range(72):
            angle = scan.angle_min + beam * scan.angle_increment
            wall_x = (10.0 - self._x) if math.cos(angle) > 0.0 else (10.0 + self._x)
            wall_y = (10.0 - self._y) if math.sin(angle) > 0.0 else (10.0 + self._y)
            ahead = wall_x / max(abs(math.cos(angle)), 1e-6)
            scan.ranges.append(min(ahead, wall_y / max(abs(math.sin(angle)), 1e-6)))
        self._send("/scan", scan)

    def _report(self, has_goal: bool) -> None:
        """Publish the status of each action."""
        for action in self._actions:
            message = GoalStatusArray()
            self._stamp(message)
            if has_goal and (not action or action in self._stop.actions.split()):
                status = GoalStatus(GoalID(id=f"{action} one"), GoalStatus.ACTIVE, "")
                message.status_list.append(status)
            self._send(f"{rospy.get_name()}/{action}/status".replace("//", "/"), message)

    def _plan(self, is_empty: bool) -> None:
        """Publish the plans, to a goal 5 m away."""
        path = Path()
        self._stamp(path)
        for step in range(0 if is_empty else 50):
            pose = PoseStamped(header=path.header)
            pose.pose.position.x = self._x + 0.1 * step
            pose.pose.position.y = self._y
            pose.pose.orientation.w = 1.0
            path.poses.append(pose)
        self._send(f"{rospy.get_name()}/NavfnROS/plan", path)
        if not is_empty:
            self._send(f"{rospy.get_name()}/{PLANNER}/global_plan", path)

    def _stamp(self, message: Any, frame: str = "odom") -> None:
        message.header.stamp = rospy.get_rostime()
        message.header.frame_id = frame

    def _send(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)


# -- the rows --------------------------------------------------------------------------------------
def row_of(stop: ForeignStop) -> List[str]:
    """Play a stop beside the black box, and return stack, stop, whether it is right, and words."""
    with RosMaster() as master, tempfile.TemporaryDirectory() as folder:
        box_module = "applr_ros1.nodes.black_box.node"
        box = master.spawn(sys.executable, "-m", box_module, f"_folder:={folder}")
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
