"""What runs on a desk: a room per command, each started as `python -m training.ROOM`, above what they share."""
