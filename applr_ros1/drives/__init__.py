"""Web page that replays recorded drives."""
# Import rule: of this repository, modules here import only worlds and common; no ROS.
