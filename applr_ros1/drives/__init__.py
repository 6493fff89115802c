"""Web page that replays recorded drives."""
# Imports worlds and common; no ROS.
