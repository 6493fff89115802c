"""The classical planner (navfn and the DWA trajectory planner of move_base), free of ROS."""
