"""ROS node `movers`, which tracks and predicts moving obstacles for costmaps, policy and display."""
# Imports movers, robots and the shared modules of nodes.
