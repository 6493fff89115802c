"""Training and evaluation: the commands, and a subpackage for each of their parts."""
# May import every package except nodes, and no ROS.
