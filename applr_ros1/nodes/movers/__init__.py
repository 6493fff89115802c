"""ROS node `movers`, which tracks and predicts moving obstacles for costmaps, policy and display."""
# Import rule: of this repository, modules here import only movers, robots and the shared modules of nodes.
