"""Provenance of results: date, commit, versions, processor and command, recorded by evaluations and training runs."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from contextlib import suppress
from datetime import datetime, timezone
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Dict

ROOT = str(
    Path(__file__).resolve().parents[2]
)  # root of the checkout, even if imported through a catkin workspace
PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "pybullet",
    "torch",
    "gymnasium",
)  # packages whose version can change a result


def provenance(seed: int) -> Dict[str, Any]:
    """Return what is needed to reproduce the results, as JSON values. The date is in UTC."""
    installed = {name: metadata.version(name) for name in PACKAGES if find_spec(name)}
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": commit(),
        "versions": {"python": platform.python_version(), **installed},
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "seed": seed,
        "command": shlex.join([os.path.basename(sys.argv[0]), *sys.argv[1:]]),
    }


def commit() -> str:
    """Return the commit of this package, with " and changes" if files differ; "unknown" outside a checkout."""
    command = [
        "git",
        "-C",
        ROOT,
        "describe",
        "--always",
        "--abbrev=40",
        "--exclude=*",
        "--dirty= and changes",
    ]
    alone = {**os.environ, "GIT_CEILING_DIRECTORIES": str(Path(ROOT).parent)}
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=10, check=True, env=alone
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def _cpu() -> str:
    """Return the name of the processor, as reported by the system."""
    with suppress(OSError), open("/proc/cpuinfo") as file:
        for line in file:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def without_folders(option: str) -> str:
    """Return a text option, such as a comma-separated list of worlds, with each path reduced to its base name."""
    return ",".join(Path(part).name for part in option.split(","))
