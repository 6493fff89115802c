"""Rosbag files: a reader that returns a Drive, and a writer."""
