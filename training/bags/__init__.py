"""Rosbag files: readers of recorded drives, conversion to episodes, and a writer for simulated drives."""
# Import rule: of this repository, modules here import only env, replay and common.

SECOND = 1_000_000_000  # one second [ns]
