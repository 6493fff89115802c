"""ROS node `move_base`: topics, services and actions of the C++ move_base around planner.move_base.MoveBase."""
# Import rule: of this repository, modules here import only planner, robots and the shared modules of nodes.
