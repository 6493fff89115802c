"""Moving obstacles around the robot: the tracker that finds it in scans, and where it will be. Knows nothing of ROS."""
# Imports robots and common; no ROS.
