"""ROS nodes, a folder for each program. The modules in this folder are shared by several nodes."""
# Import rule: modules here may import all packages but training. Only they and sim_bridge's ros_*.py depend on ROS.
