"""ROS node `viewer`: a web page with the robot, its planner and its parameters, made with viser.

The node uses only public topics and services of the other nodes.
"""
