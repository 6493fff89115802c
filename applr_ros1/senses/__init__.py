"""What a robot has sensed, for all who act on it or explain it."""
