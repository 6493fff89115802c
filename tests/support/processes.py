"""Processes as the system lists them."""


def is_alive(pid):
    """Whether a process is there and has not ended; one that only waits to be reaped has ended."""
    try:
        with open("/proc/%d/stat" % pid) as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
