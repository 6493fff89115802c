"""The running stack with a relay: bridge, move_base, collision monitor and applr node."""

import time

import actionlib
import numpy as np
import rosgraph
import rospy
from actionlib_msgs.msg import GoalStatus
from applr_ros1.msg import Decision
from move_base_msgs.msg import MoveBaseAction
from std_msgs.msg import String
from std_srvs.srv import Empty

from tests.faults.relay import Relay
from tests.support.nodes import decided, goal
from tests.support.robots import JACKAL_PARAMETERS
from tests.support.ros import LONGEST, Kept, wait_for
from worlds import Course, World
from worlds.sdf_writer import write

LENGTH = 19.0  # length of the free way ahead of the robot's start [m]
GOAL = 17.0  # distance of the goal from the start [m]
# Speed below which the Jackal may slide on for a second, as in Gazebo [m/s]
CREEP = 0.2
PERIOD = 0.5  # decision period of the applr node [s]
NODES = {
    "sim_bridge": (
        *(
            "/clock:=/sim/clock",
            "/tf:=/sim/tf",
            "front/scan:=/sim/scan",
            "odometry/filtered:=/sim/odometry",
        ),
        *("cmd_vel:=/sim/cmd_vel", "_simulator:=kinematic"),
    ),
    "move_base": ("odom:=odometry/filtered", "cmd_vel:=move_base/cmd_vel"),
    "collision_monitor": (
        "scan:=front/scan",
        "odom:=odometry/filtered",
        "cmd_vel_in:=move_base/cmd_vel",
    ),
    "applr": ("_method:=applr", "_period:=%g" % PERIOD),
}
# Topics of nodes that print no "ready".
READY = {"collision_monitor": "/collision_monitor/action"}


def alley(path):
    """Write a .world file with a straight way between two rows of posts and a wall at its end.
    Return its path.
    """
    rows = [(at, side * 2.2, 0.1) for at in np.arange(-1.0, LENGTH, 0.5) for side in (-1.0, 1.0)]
    wall = [(LENGTH, y, 0.1) for y in np.arange(-2.2, 2.25, 0.2)]
    course = Course(
        (0.0, 0.0, 0.0), (GOAL, 0.0, 0.0), None, 0.5, np.array([[0.0, 0.0], [GOAL, 0.0]])
    )
    write(World("alley", np.array(rows + wall), np.empty((0, 5)), course), path)
    return path


class Stack:
    """Nodes as child processes by name, relay, client of move_base's action, and helpers for
    tests.
    """

    PERIOD = PERIOD

    def __init__(self, ros, folder):
        self.ros = ros
        self.nodes = {}
        self.decisions = []
        self.actions = []
        rospy.set_param("/use_sim_time", True)
        rospy.set_param("/sim_bridge/world", alley(str(folder / "alley.world")))
        rospy.Subscriber("/applr/decision", Decision, lambda m: self.decisions.append(decided(m)))
        rospy.Subscriber("/collision_monitor/action", String, lambda m: self.actions.append(m.data))
        self.relay = Relay()
        for name in NODES:
            self.start(name, wait=False)
        for name in NODES:
            self.wait_until_up(name)
        self.client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        assert self.client.wait_for_server(rospy.Duration(LONGEST))
        wait_for(lambda: self.relay.truth, "the robot")

    def start(self, name, wait=True):
        """Start or restart a node of NODES, with the parameters that a launch file would set."""
        if name == "move_base":
            rospy.set_param("/move_base", dict(JACKAL_PARAMETERS, applr={"period": PERIOD}))
        self.nodes[name] = self.ros.node(name, *NODES[name])
        if wait:
            self.wait_until_up(name)

    def wait_until_up(self, name):
        child = self.nodes[name]

        def up():
            if name in READY:
                return any(
                    topic == READY[name]
                    for topic, _ in rosgraph.Master("/up").getPublishedTopics("")
                )
            return "ready" in child.text

        child.until(up)

    def output(self, name):
        """Return the output of a node so far."""
        return self.nodes[name].text

    def back_to_the_start(self):
        self.cancel_goal()
        rospy.ServiceProxy("/sim_bridge/reset", Empty)()
        wait_for(lambda: abs(self.relay.x) < 0.1, "the start")
        self.relay.touched = False

    @property
    def goal_is_over(self):
        return not self.client.gh or self.client.get_state() not in (
            GoalStatus.PENDING,
            GoalStatus.ACTIVE,
        )

    def cancel_goal(self):
        """Cancel the latest goal. cancel_all_goals uses another connection, and might cancel the
        next goal as well.
        """
        if not self.goal_is_over:
            self.client.cancel_goal()
            self.until(lambda: self.goal_is_over, "the end of the goal")

    def send(self, x=GOAL):
        self.client.send_goal(goal(x))

    def under_way(self, speed=0.6, room=7.0):
        """Drive until the robot is faster than `speed` [m/s], with at least `room` [m] before the
        goal.
        """

        def drives():
            if self.goal_is_over or self.relay.x > GOAL - room:
                if self.relay.x > 2.0:
                    self.back_to_the_start()
                self.send()
            return self.relay.speed > speed

        self.until(drives, "motion")

    def stands_after(self, break_it, within=2.0, locks=False):
        """Call break_it() and return the simulated time until the robot is at rest [s].

        Within `within` [s], commands must be zero and the speed below CREEP. If `locks`, the wheels
        lock instead of braking gently and may slip for seconds, so that only the commands are
        checked.
        """
        broken = self.relay.now
        kept = Kept()
        break_it()
        self.until(lambda: abs(self.relay.speed) < 0.01 and self.relay.now > broken, "standstill")
        now = self.relay.now  # Later states are from before a reset of the simulator.
        slow, stood = (
            next(
                time
                for time, _, v in list(self.relay.truth)
                if broken < time <= now and abs(v) < most
            )
            - broken
            for most in (CREEP, 0.01)
        )
        took = max(0.0 if locks else slow, self.relay.driven - broken)
        waited = kept.waiting()
        message = "%.2f s (slow %.2f s, at rest %.2f s), kept waiting for %.2f s; %s"
        assert took < within + waited, message % (took, slow, stood, waited, self.actions[-9:])
        return stood

    def drives_again(self, speed=0.3):
        self.until(lambda: self.relay.speed > speed, "motion")

    def until(self, condition, what):
        """Wait like wait_for. A failure reports the state of robot, collision monitor and
        move_base.
        """
        try:
            return wait_for(condition, what)
        except AssertionError as late:
            relay = self.relay
            client = self.client
            ended = (
                "goal: state %d %s" % (client.get_state(), client.get_goal_status_text())
                if client.gh
                else "no goal"
            )
            lines = [
                "%s; x %.2f, aside %s, %.2f m/s; planned %s"
                % (late, relay.x, relay.aside, relay.speed, relay.planned[-3:]),
                "%.2f, in simulated time %.2f; sent on %s"
                % (time.time(), relay.now, relay.commands[-3:]),
                "%s; %s" % (self.actions[-3:], ended),
                *self.output("move_base").splitlines()[-10:],
            ]
            raise AssertionError("\n".join(lines)) from None
