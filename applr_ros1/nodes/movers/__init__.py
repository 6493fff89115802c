"""ROS node `movers`, which tracks and predicts moving obstacles."""
