"""Shared parts of tests: stand-ins for nodes and robots, slow reference implementations, synthetic
worlds and maps.
"""

from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"
# Time after which a process counts as hanging: ten times the longest test on an idle machine [s]
HANGS = 600.0


def lines_with(text, words):
    """Return the lines of a text that contain some words."""
    return [line for line in text.splitlines() if words in line]


def is_alive(pid):
    """Return whether a process runs. A zombie does not count."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
