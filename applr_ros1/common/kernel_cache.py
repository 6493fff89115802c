"""Cache of the machine code of kernels on disk, for numba's dispatchers.

The cache is the first of these folders that only this user can write, because machine code is
loaded from it: `NUMBA_CACHE_DIR`, `~/.cache`, or the folder for temporary files. If there is none,
or if the disk is full, each process compiles its kernels anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import stat
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any, Callable

import numba
from numba.core import serialize, types
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult

_LOGGER = logging.getLogger(__name__)
# limit on cached files (12 versions of all kernels); the least recently used are removed
KEPT_FILES = 6000
# numba has no types for these two functions.
dumps: Callable[[Any], bytes] = serialize.dumps
rebuild: Callable[..., CompileResult] = CompileResult._rebuild
# Nor does it declare the items and fields of its tuples.
TUPLE: Any = types.BaseTuple
NAMED_TUPLE: Any = types.BaseNamedTuple


class KernelCache(NullCache):
    """Disk cache of one kernel, for numba's dispatcher: a file for each tuple of argument types.

    Args:
        function: Python function of the kernel.
        sources: Hash of the sources on which its machine code depends.
    """

    def __init__(self, function: Callable[..., Any], sources: str):
        self._function = function
        self._sources = sources

    @property
    def cache_path(self) -> str:
        """Folder of the cache; "" if there is none."""
        return cache_folder()

    def load_overload(self, signature: Any, target_context: Any) -> CompileResult | None:
        """Return the cached compilation for these types, or None if it is missing or damaged."""
        # As in numba's own Cache.load_overload: the context must know the functions of the loaded
        # code.
        target_context.refresh()
        if not cache_folder():
            return None
        cache_file = self._path(signature, target_context.codegen())
        try:
            result_parts = pickle.loads(cache_file.read_bytes())
            os.utime(cache_file)  # _remove_unused sorts by the time of the last use.
        except Exception:  # Unpickling a damaged file may raise any exception.
            return None
        return rebuild(target_context, *result_parts)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Write a compilation to the cache. Other processes see the file once it is complete."""
        # Code with addresses of this process (dynamic globals) is useless to any other process.
        if not cache_folder() or data.library.has_dynamic_globals:
            return
        cache_file = self._path(signature, data.library.codegen)
        with contextlib.suppress(OSError):
            partial_file = Path(f"{cache_file}.{os.getpid()}")
            partial_file.write_bytes(dumps(data._reduce()))
            os.replace(partial_file, cache_file)
            _remove_unused()
        _LOGGER.info("compiled %s", cache_file.name)

    def _path(self, signature: Any, codegen: Any) -> Path:
        """Return the file of the machine code for a signature on this processor."""
        function = self._function
        argument_types = getattr(signature, "args", signature)
        type_names = [_full_name(argument_type) for argument_type in argument_types]
        target = sys.version_info[:2], numba.__version__, codegen.magic_tuple()
        cache_key = repr((target, type_names, self._sources)).encode()
        checksum = hashlib.sha256(cache_key).hexdigest()[:32]
        file_name = f"{function.__module__}.{function.__qualname__}-{checksum}"
        return Path(cache_folder(), file_name)


def _full_name(argument_type: Any) -> str:
    """Return the name of a type, with the class and the fields of each NamedTuple in it.

    numba's name has only the last word of the class and the types of the fields. A kernel that
    takes the NamedTuples of several modules imports none of them, so its sources do not tell their
    fields either.
    """
    if not isinstance(argument_type, TUPLE):
        return str(argument_type)
    class_name = "tuple"
    if isinstance(argument_type, NAMED_TUPLE):
        class_name = f"{argument_type.instance_class} {argument_type.fields}"
    item_names = [_full_name(item_type) for item_type in argument_type]
    return f"{class_name} {item_names}"


@functools.lru_cache(maxsize=None)
def cache_folder() -> str:
    """Return the folder of the cache, or "" if there is none that only this user can write.

    The folder is created if it is missing.
    """
    cache_home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    temporary_folder = os.environ.get("TMPDIR") or "/tmp"
    folders = [
        os.path.join(cache_home, "applr_ros1"),
        os.path.join(temporary_folder, f"applr_ros1-{os.getuid()}"),
    ]
    if os.environ.get("NUMBA_CACHE_DIR"):
        folders.insert(
            0, os.path.abspath(os.path.join(os.environ["NUMBA_CACHE_DIR"], "applr_ros1"))
        )
    for folder in folders:
        # expanduser keeps "~" if the user has no home folder.
        if os.path.isabs(folder) and _is_private(folder):
            return folder
    problem = f"no folder for compiled kernels can be written ({', '.join(folders)})"
    remedy = "set NUMBA_CACHE_DIR to a folder of your own"
    warnings.warn(f"{problem}: every start recompiles, {remedy}", stacklevel=2)
    return ""


def _is_private(folder: str) -> bool:
    """Return whether a folder exists or can be made, and only this user can write to it."""
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        folder_status = os.stat(folder)
        others_may_write = folder_status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if folder_status.st_uid != os.getuid() or others_may_write:
            return False
        tempfile.TemporaryFile(dir=folder).close()  # The disk may be full or read-only.
    except OSError:
        return False
    return True


@functools.lru_cache(maxsize=None)
def _remove_unused() -> None:
    """Remove the least recently used files beyond KEPT_FILES. Runs once per process."""
    cached_files = sorted(os.scandir(cache_folder()), key=lambda entry: -entry.stat().st_mtime)
    for unused_file in cached_files[KEPT_FILES:]:
        os.unlink(unused_file.path)
