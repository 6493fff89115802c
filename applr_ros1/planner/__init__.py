"""The classical planner of move_base: costmaps, navfn, two local planners, recoveries, MoveBase."""
