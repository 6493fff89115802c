"""Moving obstacles around the robot: detection, tracking and prediction from scans, without ROS."""
