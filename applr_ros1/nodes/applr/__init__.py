"""ROS node `applr`, which sets the planner's parameters at every decision."""
# Imports policy, robots and the shared modules of nodes.
