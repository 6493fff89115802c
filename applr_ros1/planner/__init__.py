"""The classical planner of move_base: costmaps, navfn, the two local planners, recoveries, MoveBase."""
