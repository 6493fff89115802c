"""ROS node `move_base`, with the topics, services and actions of the C++ move_base."""
