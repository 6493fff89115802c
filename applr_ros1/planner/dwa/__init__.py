"""DWAPlannerROS of dwa_local_planner: sampled velocities, seven critics, stop and turn."""
# Imports costmap/, parameters/ and the modules that both local planners share.
