"""The classical planner of move_base: costmaps, navfn, the two local planners, recoveries, MoveBase."""
# Import rule: modules here import only numpy, numba and applr_ros1.common, never ROS.
