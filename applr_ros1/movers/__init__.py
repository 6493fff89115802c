"""Moving obstacles around the robot: detection, tracking and prediction from scans, without ROS."""
# Import rule: of this repository, modules here import only robots and common; no ROS.
