"""Provenance of results, recorded by evaluations and training runs."""

from __future__ import annotations

import hashlib
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

from applr_ros1.common.extras import OURS

# Root of the checkout, even if imported through a catkin workspace
ROOT = Path(__file__).resolve().parents[2]
# Packages whose version can change a result
PACKAGES = ("numpy", "scipy", "numba", "pybullet", "torch", "gymnasium")


def provenance(seed: int) -> Dict[str, Any]:
    """Return what is needed to reproduce the results, as JSON values.

    It has date (UTC), commit, versions, processor, and the command.
    """
    versions = {"python": platform.python_version()}
    for package_name in PACKAGES:
        if find_spec(package_name):
            versions[package_name] = metadata.version(package_name)
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": commit(),
        "versions": versions,
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "seed": seed,
        "command": shlex.join([os.path.basename(sys.argv[0]), *sys.argv[1:]]),
    }


def commit() -> str:
    """Return the commit of this package.

    " and changes" follows if files differ. Outside a checkout, return "unknown".
    """
    # Without tags, which would replace the commit. The ceiling keeps git from a checkout around a
    # package that pip installed.
    git_command = [
        "git",
        "describe",
        "--always",
        "--abbrev=40",
        "--exclude=*",
        "--dirty= and changes",
    ]
    environment = {**os.environ, "GIT_CEILING_DIRECTORIES": str(ROOT.parent)}
    try:
        answer = subprocess.run(
            git_command,
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return answer.stdout.strip()


def source_hash() -> str:
    """Return a hash of all sources of this package's Python code.

    It tells states of a checkout apart that have one commit.
    """
    digest = hashlib.sha256()
    for package_name in OURS:
        for source_file in sorted((ROOT / package_name).rglob("*.py")):
            digest.update(str(source_file.relative_to(ROOT)).encode())
            digest.update(source_file.read_bytes())
    return digest.hexdigest()


def _cpu() -> str:
    """Return the name of the processor, as reported by the system."""
    with suppress(OSError), open("/proc/cpuinfo") as cpu_info:
        for line in cpu_info:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def without_folders(option: str) -> str:
    """Return a text option, such as a list of worlds, with each path reduced to its base name."""
    return ",".join(Path(listed_path).name for listed_path in option.split(","))
