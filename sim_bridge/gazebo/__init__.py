"""Gazebo's ROS interface on the simulated robot, for programs that were written for Gazebo (front.py)."""
