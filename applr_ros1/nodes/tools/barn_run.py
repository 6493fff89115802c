"""One run of the BARN Challenge's runner in a process of its own: `python -m applr_ros1.nodes.tools.barn_run`.

barn.py starts it for every run. Whatever the run leaves behind is a child of this process in the end, and is ended with
it; so no simulator or ROS master outlives its run.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from . import processes

TOO_LONG = 124  # exit status of a run that did not end in time, as that of timeout(1)


def main(arguments) -> int:
    """Arguments: seconds, log file, command. Returns the command's exit status, or TOO_LONG."""
    processes.adopt_orphans()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with open(arguments[1], "wb") as log:
        child = processes.start(arguments[2:], dict(os.environ), log)
        try:
            return child.wait(float(arguments[0]))
        except subprocess.TimeoutExpired:
            return TOO_LONG
        except KeyboardInterrupt:
            return 128 + signal.SIGINT
        finally:
            processes.stop(child, 8.0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
