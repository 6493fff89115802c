"""The running stack with a relay: bridge, move_base, collision monitor and applr node."""

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
    # All streams of the simulator go through the relay.
    "sim_bridge": (
        "/clock:=/sim/clock",
        "/tf:=/sim/tf",
        "front/scan:=/sim/scan",
        "odometry/filtered:=/sim/odometry",
        "cmd_vel:=/sim/cmd_vel",
        "_simulator:=kinematic",
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
    posts = []
    # Both sides, and the wall
    for post_x in np.arange(-1.0, LENGTH, 0.5):
        posts += [(post_x, -2.2, 0.1), (post_x, 2.2, 0.1)]
    for post_y in np.arange(-2.2, 2.25, 0.2):
        posts.append((LENGTH, post_y, 0.1))
    course = Course(
        start=(0.0, 0.0, 0.0),
        goal=(GOAL, 0.0, 0.0),
        finish_y=None,
        goal_tolerance=0.5,
        path=np.array([[0.0, 0.0], [GOAL, 0.0]]),
    )
    write(World("alley", np.array(posts), np.empty((0, 5)), course), path)
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
        rospy.Subscriber("/applr/decision", Decision, self._on_decision)
        rospy.Subscriber("/collision_monitor/action", String, self._on_action)
        self.relay = Relay()
        # The nodes import for seconds, all of them at once.
        for node_name in NODES:
            self.start(node_name, wait=False)
        for node_name in NODES:
            self.wait_until_up(node_name)
        self.client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        assert self.client.wait_for_server(rospy.Duration(LONGEST))
        wait_for(lambda: self.relay.truth, "the robot")

    def _on_decision(self, message):
        self.decisions.append(decided(message))

    def _on_action(self, message):
        self.actions.append(message.data)

    def start(self, name, wait=True):
        """Start or restart a node of NODES, with the parameters that a launch file would set."""
        if name == "move_base":
            rospy.set_param("/move_base", dict(JACKAL_PARAMETERS, applr={"period": PERIOD}))
        self.nodes[name] = self.ros.node(name, *NODES[name])
        if wait:
            self.wait_until_up(name)

    def wait_until_up(self, name):
        """Wait until a node works: it has printed "ready", or has its topic."""
        child = self.nodes[name]

        def is_up():
            if name not in READY:
                return "ready" in child.text
            published = dict(rosgraph.Master("/up").getPublishedTopics(""))
            return READY[name] in published

        child.until(is_up)

    def output(self, name):
        """Return the output of a node so far."""
        return self.nodes[name].text

    def back_to_the_start(self):
        """Cancel the goal, and put the robot back."""
        self.cancel_goal()
        # The monitor brakes for a while. Such a command on its way would drive the robot off again.
        self.until(lambda: self.relay.commands[-1].v == 0.0, "the end of braking")
        rospy.ServiceProxy("/sim_bridge/reset", Empty)()
        wait_for(lambda: abs(self.relay.x) < 0.1, "the start")
        self.relay.touched = None

    @property
    def goal_is_over(self):
        """True if there is no goal that move_base pursues."""
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
        """Send a goal x [m] down the alley."""
        self.client.send_goal(goal(x))

    def under_way(self, speed=0.6, room=7.0):
        """Drive until the robot is faster than `speed` [m/s], with at least `room` [m] before the
        goal.
        """

        def drives():
            """Return whether the robot is fast enough. Send the goal again if it needs one."""
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
        broken_at = self.relay.now
        stopwatch = Kept()
        break_it()
        self.until(
            lambda: abs(self.relay.speed) < 0.01 and self.relay.now > broken_at, "standstill"
        )
        stood_at = self.relay.now  # Later states are from before a reset of the simulator.

        def slower_than(speed):
            """Return the time from the fault until the robot was slower than a speed [m/s]."""
            # A copy, because the relay's thread goes on adding states.
            for state in list(self.relay.truth):
                if broken_at < state.time <= stood_at and abs(state.speed) < speed:
                    return state.time - broken_at
            raise AssertionError("the robot was not seen at rest")

        creeps_after = slower_than(CREEP)
        rests_after = slower_than(0.01)
        # `driven` is when the latest command other than zero came.
        last_command_after = self.relay.driven - broken_at
        stopped_after = last_command_after if locks else max(creeps_after, last_command_after)
        waiting_s = stopwatch.waiting()
        assert max(0.0, stopped_after) < within + waiting_s, (
            f"{stopped_after:.2f} s (slow {creeps_after:.2f} s, at rest {rests_after:.2f} s), "
            f"kept waiting for {waiting_s:.2f} s; {self.actions[-9:]}"
        )
        return rests_after

    def drives_again(self, speed=0.3):
        """Wait until the robot is faster than `speed` [m/s]."""
        self.until(lambda: self.relay.speed > speed, "motion")

    def until(self, condition, what):
        """Wait like wait_for. A failure has the latest actions of the collision monitor, and the
        output of move_base.
        """
        try:
            return wait_for(condition, what)
        except AssertionError as late:
            report = f"{late}; {self.actions[-3:]}\n{self.output('move_base')}"
            raise AssertionError(report) from None
