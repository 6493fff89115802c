"""A stand-in for what the applr node hears and is heard by: a robot that stands, with a plan and perhaps a goal.

Used by tests of the applr node and of bags; it lives in the test's own process.
"""

import threading

import numpy as np


def decided(message):
    """What an applr_ros1/Decision says, as a dict; "theta" is empty where the method's output was refused."""
    sets = {
        key: dict(zip(of.names, of.values)) for key, of in (("theta_prev", message.before), ("theta", message.after))
    }
    return dict(sets, stamp=str(message.header.stamp), refused=message.refused)


class Robot:
    """Publishes what a Jackal and move_base would: scan, odometry, plan, goal status; and hears the node."""

    def __init__(self):
        import rospy
        from actionlib_msgs.msg import GoalStatusArray
        from applr_ros1.msg import Decision, Parameters
        from diagnostic_msgs.msg import DiagnosticArray
        from nav_msgs.msg import Odometry, Path
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import LaserScan
        from std_msgs.msg import Time

        self.scan = rospy.Publisher("/front/scan", LaserScan, queue_size=1)
        self.odom = rospy.Publisher("/odometry/filtered", Odometry, queue_size=1)
        self.plan = rospy.Publisher("/move_base/NavfnROS/plan", Path, queue_size=1)
        self.status = rospy.Publisher("/move_base/status", GoalStatusArray, queue_size=1)
        self.clock = rospy.Publisher("/clock", Clock, queue_size=1)
        for topic, kind, callback in (
            ("/applr/decision", Decision, self._on_decision),
            ("/applr/heartbeat", Time, self._on_heartbeat),
            ("/applr/parameters", Parameters, self._on_parameters),
            ("/diagnostics", DiagnosticArray, self._on_diagnostics),
        ):
            rospy.Subscriber(topic, kind, callback, queue_size=50)
        self.simulated = False
        self.reset()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        self._over.set()
        self._thread.join(2.0)

    def reset(self):
        rng = np.random.default_rng(0)
        self.ranges = rng.uniform(0.3, 4.0, 720).astype(np.float32)
        self.pose, self.twist = (0.5, -0.25, 0.4), (0.3, -0.1)
        self.path = np.column_stack([np.linspace(0.5, 5.0, 180), np.sin(np.linspace(0, 2, 180))])
        self.goal = None
        self.now = 100.0
        self.simulated = False
        self.statuses = True  # whether move_base's status is published
        self.decisions, self.observations, self.beats, self.parameters, self.values = [], [], [], [], {}

    def _on_decision(self, msg):
        self.decisions.append(decided(msg))
        self.observations.append(np.array(msg.observation, dtype=np.float32))

    def _on_heartbeat(self, msg):
        self.beats.append(msg.data.to_sec())

    def _on_parameters(self, msg):
        self.parameters.append(list(msg.values))

    def _on_diagnostics(self, msg):
        self.values = {v.key: v.value for v in msg.status[0].values}
        self.values["level"], self.values["message"] = msg.status[0].level, msg.status[0].message

    def count(self, key):
        return int(self.values.get(key, 0))

    def _run(self):
        while not self._over.wait(0.02):
            if self.simulated:
                self.now += 0.02
                message = self._messages()["clock"]
                self.clock.publish(message)
            messages = self._messages()
            for name in ("status", "odom", "scan", "plan"):
                if messages[name] is not None:
                    getattr(self, name).publish(messages[name])

    def _messages(self):
        import rospy
        from actionlib_msgs.msg import GoalStatus, GoalStatusArray
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Odometry, Path
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import LaserScan

        now = rospy.Time.from_sec(self.now) if self.simulated else rospy.Time.now()
        ranges, status = self.ranges, GoalStatusArray()
        scan = LaserScan(
            angle_min=-2.35619,
            angle_max=2.35619,
            angle_increment=4.71238 / 719,
            range_min=0.1,
            range_max=30.0,
            ranges=ranges,
        )
        odom, plan = Odometry(child_frame_id="base_link"), Path()
        odom.pose.pose.position.x, odom.pose.pose.position.y = self.pose[:2]
        odom.pose.pose.orientation.z = np.sin(self.pose[2] / 2)
        odom.pose.pose.orientation.w = np.cos(self.pose[2] / 2)
        odom.twist.twist.linear.x, odom.twist.twist.angular.z = self.twist
        for x, y in self.path:
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = x, y
            plan.poses.append(pose)
        if self.goal is not None:
            entry = GoalStatus(status=GoalStatus.ACTIVE)
            entry.goal_id.id = self.goal
            status.status_list.append(entry)
        for message, frame in ((scan, "front_laser"), (odom, "odom"), (plan, "odom"), (status, "")):
            message.header.stamp, message.header.frame_id = now, frame
        return {
            "scan": scan if ranges is not None else None,
            "odom": odom,
            "status": status if self.statuses else None,
            "plan": plan if self.goal is not None else None,
            "clock": Clock(now),
        }
