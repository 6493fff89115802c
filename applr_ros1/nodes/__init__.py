"""The ROS nodes. Beside them only sim_bridge's ros_bridge.py and ros_topics.py import rospy."""
