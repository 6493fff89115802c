"""ROS node `collision_monitor`, between a source of velocity commands and the base, and its guard process."""
# Import rule: of this repository, modules here import only monitor, robots and the shared modules of nodes.
