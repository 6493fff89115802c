"""ROS node `collision_monitor`, between a source of commands and the base, and its guard."""
