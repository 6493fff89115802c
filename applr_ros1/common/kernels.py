"""The decorator `kernel`: numba's njit with machine code that is kept on disk between processes.

Every compiled function of the package carries it. numba compares only the file in which a kernel stands: a change in a
function or constant that the kernel takes from another file would go unnoticed. Therefore the folder is named by a hash
of all sources of the kernel's package, so that versions of a package side by side have folders of their own, and a
change in one package leaves the machine code of the others.

The folder lies in `NUMBA_CACHE_DIR`, in `~/.cache`, or in the folder for temporary files: the first of them in which
this user alone can write, since machine code is loaded from it. Without any, or where the disk is full, each process
compiles anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any, Callable

import numba

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "applr_ros1/planner",
    "applr_ros1/monitor",
    "applr_ros1/movers",
    "sim_bridge",
    "applr_ros1/sim_bridge",  # where pip installed it
)  # no kernel takes one of another
KEPT_FOLDERS = 24  # folders; beyond, those that were unused longest are removed


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile `function` with numba.njit and keep the machine code.

    Args:
        function: the Python function, in the subset of the language that numba compiles.
        options: those of numba.njit, for instance `error_model="numpy"`; without `cache`.

    Returns:
        numba's dispatcher; a decorator if only options are given.
    """
    if function is None:
        return functools.partial(kernel, **options)
    # numba keeps code by the path of its file, and a catkin workspace reaches this repository through links
    path = os.path.realpath(function.__code__.co_filename)
    function.__code__ = function.__code__.replace(co_filename=path)
    folder = cache_folder(next(name for name in PACKAGES if (ROOT / name) in Path(path).parents))
    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, folder
    try:
        made = numba.njit(cache=bool(folder), **options)(function)
    finally:
        config.CACHE_DIR = before
    keep = made._cache.save_overload

    def keep_if_it_can(signature: Any, code: Any) -> None:
        try:
            keep(signature, code)
        except OSError as problem:  # numba would end the process, for instance where the disk is full
            warnings.warn(
                f"{folder}: cannot keep compiled kernels ({problem}): every start compiles anew", stacklevel=2
            )

    made._cache.save_overload = keep_if_it_can
    return made


@functools.lru_cache(maxsize=None)
def cache_folder(package: str) -> str:
    """Return the folder for machine code of one of PACKAGES, made if missing; "" if none is this user's alone."""
    sources = hashlib.sha256()
    for path in sorted((ROOT / package).rglob("*.py")):
        sources.update(path.read_bytes())
    places = [
        os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "applr_ros1"),
        os.path.join(os.environ.get("TMPDIR") or "/tmp", f"applr_ros1-{os.getuid()}"),
    ]
    if os.environ.get("NUMBA_CACHE_DIR"):
        places.insert(0, os.path.abspath(os.path.join(os.environ["NUMBA_CACHE_DIR"], "applr_ros1")))
    for place in filter(os.path.isabs, places):  # "~" stays where neither HOME nor the user's entry names a folder
        folder = os.path.join(place, sources.hexdigest()[:16])
        with contextlib.suppress(OSError):
            os.makedirs(folder, mode=0o700, exist_ok=True)
            if any(entry.st_uid != os.getuid() or entry.st_mode & 0o022 for entry in map(os.stat, (place, folder))):
                continue
            os.utime(folder)  # the time of its last use
            tempfile.TemporaryFile(dir=folder).close()  # else numba refuses the folder, and thereby the kernel
            for old in sorted(os.scandir(place), key=lambda entry: -entry.stat().st_mtime)[KEPT_FOLDERS:]:
                shutil.rmtree(old.path, ignore_errors=True)
            return folder
    tried = ", ".join(places)
    warnings.warn(f"no folder for compiled kernels can be written ({tried}): every start compiles anew", stacklevel=2)
    return ""
