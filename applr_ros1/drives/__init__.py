"""Recorded drives as pictures and as a page that plays them, and the comparison of two methods; without ROS."""
