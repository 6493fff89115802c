"""ROS node `movers`, which tracks and predicts moving obstacles for costmaps, policy and display."""
