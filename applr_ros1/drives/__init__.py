"""Recorded drives as pictures and as a page that plays them."""
# Imports worlds and common; no ROS.
