"""Training and evaluation: the commands, and their parts in subpackages."""
# Import rule: modules here may import every package except nodes, and no ROS.
