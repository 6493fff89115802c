"""ROS nodes, a folder for each program. The modules in this folder are shared by several nodes."""
# Imports all packages except training. Besides this package, only sim_bridge's ros_*.py depend on ROS.
