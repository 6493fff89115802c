"""State of processes, from /proc."""


def is_alive(pid):
    """Return whether a process runs. A zombie does not count."""
    try:
        with open("/proc/%d/stat" % pid) as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
