"""ROS node `applr`, which sets the planner's parameters at every decision."""
# Import rule: of this repository, modules here import only policy, robots and the shared modules of nodes.
