"""ROS node `black_box`: keeps the last minutes, writes a bag at each stop, and says why."""
