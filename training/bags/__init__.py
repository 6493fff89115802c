"""Rosbag files: reading recorded drives, turning them into episodes, and writing simulated drives as bags."""
