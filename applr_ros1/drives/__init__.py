"""Recorded drives as pictures and animations, and the comparison of two methods by theirs; knows nothing of ROS."""
