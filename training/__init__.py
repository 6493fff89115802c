"""Programs for a desk computer: a room per command, started as `python -m training.ROOM`."""
