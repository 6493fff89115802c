"""Training and evaluation: the commands, and their parts in subpackages."""
# May import every package except nodes, and no ROS.
