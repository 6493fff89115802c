"""ROS node `collision_monitor`, between a source of velocity commands and the base, and its guard process."""
