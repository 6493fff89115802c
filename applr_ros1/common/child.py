"""A child process with limits of memory and time, in which a file of somebody else is read.

training/bags/bag.py starts one. What it answers is text or plain arrays.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from typing import Any, Mapping, Optional, Sequence


def run(
    command: Sequence[str],
    given: Any,
    limits: Mapping[str, int],
    patience_s: float,
    stdout: Any = subprocess.PIPE,
    environment: Mapping[str, str] = {},  # noqa: B006
) -> Optional[bytes]:
    """Run a Python file as a child process with limits.

    Args:
        command: The file, which calls taken() after its imports, and its arguments.
        given: What taken() returns in the child: JSON values.
        limits: By name of a limit of module resource without "RLIMIT_": "CPU" [s], "AS" [bytes], "FSIZE" [bytes].
        patience_s: Time [s] of the clock after which the child is killed.
        stdout: File for what the child writes; by default it is returned.
        environment: Variables that the child has beside those of this process.

    Returns:
        What the child wrote; b"" where that is in a file, and None where the child did not end by itself.
    """
    path = os.pathsep.join(place or os.getcwd() for place in sys.path)
    variables = {**os.environ, **environment, "PYTHONPATH": path}
    sent = json.dumps([given, dict(limits)]).encode()
    how = {"input": sent, "stdout": stdout, "stderr": subprocess.DEVNULL, "env": variables, "timeout": patience_s}
    try:
        done = subprocess.run([sys.executable, os.path.abspath(command[0]), *command[1:]], check=False, **how)
    except subprocess.TimeoutExpired:
        return None
    return None if done.returncode else done.stdout or b""


def taken() -> Any:
    """Return what run() was given, in the child; the limits hold from here on."""
    given, limits = json.load(sys.stdin)
    for name, limit in limits.items():
        resource.setrlimit(getattr(resource, "RLIMIT_" + name), (limit, limit))
    return given
