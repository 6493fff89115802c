"""The ROS nodes, a folder for each program; `common` are the parts that several share."""
# Imports all packages but training; beside it only sim_bridge's ros_*.py know ROS.
