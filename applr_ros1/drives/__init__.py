"""Recorded drives as pictures and as a page that plays them; without ROS."""
