"""ROS nodes, a folder for each program. The modules in this folder are shared by several nodes."""
