"""Planner, monitor, moving obstacles and escape motions, wired as on the robot, without ROS."""
