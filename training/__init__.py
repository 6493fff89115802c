"""Learning and measuring: the commands of this folder, and a room for each of their parts."""
# Imports all packages but nodes; no ROS.
