"""Rosbag files: reading recorded drives, turning them into episodes and courses, and writing simulated drives."""
# Imports env, replay and common.

SECOND = 1_000_000_000  # ns
