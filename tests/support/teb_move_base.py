"""Stand-in for a move_base with TebLocalPlannerROS: its topics and parameters, and no planner.

It commands the same speed for as long as it runs. Started as
`session().node("tests.support.teb_move_base")`.
"""

import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from applr_ros1.nodes.conversions import pose_stamped, twist

SPEED = 0.4  # commanded speed [m/s]
PARAMETERS = {
    "base_local_planner": "teb_local_planner/TebLocalPlannerROS",
    "controller_frequency": 10.0,
    "TebLocalPlannerROS": {"max_vel_x": 0.4, "max_vel_theta": 0.5, "xy_goal_tolerance": 0.2},
}


def main():
    """Run the node."""
    rospy.init_node("move_base")
    rospy.set_param("~", PARAMETERS)
    publishers = {
        "~GlobalPlanner/plan": Path,
        "~TebLocalPlannerROS/global_plan": Path,
        "~TebLocalPlannerROS/local_plan": Path,
        "~status": GoalStatusArray,
        "cmd_vel": Twist,
    }
    for topic, kind in publishers.items():
        publishers[topic] = rospy.Publisher(topic, kind, queue_size=5)
    rospy.Subscriber("front/scan", LaserScan, lambda scan: None)
    rospy.Subscriber("odometry/filtered", Odometry, lambda odometry: None)
    rate = rospy.Rate(PARAMETERS["controller_frequency"])
    while not rospy.is_shutdown():
        header = Header(0, rospy.Time.now(), "odom")
        poses = [pose_stamped((0.2 * i, 0.0, 0.0), "odom", header.stamp) for i in range(60)]
        for topic, publisher in publishers.items():
            if topic.endswith("plan"):
                publisher.publish(Path(header, poses))
        goal_id = GoalID(rospy.Time(1), "goal")
        statuses = [GoalStatus(goal_id, GoalStatus.ACTIVE, "")]
        publishers["~status"].publish(GoalStatusArray(header, statuses))
        publishers["cmd_vel"].publish(twist(SPEED, 0.0))
        rate.sleep()
