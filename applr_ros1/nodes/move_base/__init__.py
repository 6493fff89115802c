"""ROS node `move_base`: topics, services and actions of the C++ move_base around planner.move_base.MoveBase."""
