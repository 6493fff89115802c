"""Rosbag files: one table of topics, a reader that returns a Drive, and a writer."""

SECOND = 1_000_000_000  # one second [ns]
