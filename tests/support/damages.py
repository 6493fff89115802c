"""Damages of files, for tests of readers: functions of a path."""

import os


def written(text):
    """Return the damage of a file that has another content."""
    return lambda path: path.write_text(text)


def named_pipe(path):
    """Put a pipe in the place of a file."""
    path.unlink(missing_ok=True)
    os.mkfifo(path)
