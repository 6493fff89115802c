"""ROS node `applr`, which sets the planner's parameters at every decision."""
