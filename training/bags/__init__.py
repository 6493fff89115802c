"""Rosbag files: readers of recorded drives, conversion to episodes, and a writer for simulated drives."""
# Imports env, replay and common.

SECOND = 1_000_000_000  # one second [ns]
