"""The decorator `kernel`: numba's njit with a compile cache that follows everything a kernel calls.

Every compiled function of the package carries it. numba's own cache compares only the file in which a kernel stands:
a change in a function or constant that the kernel takes from another file goes unnoticed. Here the name of a cache file
is a digest (kernel_digest.py) of the kernel, of all kernels that it reaches and of the constants that they use. A file
is therefore never out of date, versions of the package side by side share one folder, and a docstring can change
without a compile.

The files lie in `NUMBA_CACHE_DIR`, in `~/.cache/applr_ros1/kernels`, or in the folder for temporary files: the first of
them that belongs to this user alone. Without any, each process compiles anew. Each file is written under another name
and then renamed, so that processes can fill the folder at the same time.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import platform
import stat
import tempfile
import warnings
from typing import Any, Callable

import numba
import numpy as np
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

from applr_ros1.common.kernel_digest import digest

VERSIONS = (platform.python_implementation(), platform.python_version(), numba.__version__, np.__version__)
KEPT = 16  # files of one kernel (versions times signatures): beyond, those that were unused longest go
ABANDONED = 86400.0  # seconds after which a file that was never renamed goes, too


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile `function` with numba.njit and cache the machine code by the source of everything that it calls.

    Args:
        function: the Python function, in the subset of the language that numba compiles.
        options: those of numba.njit, for instance `error_model="numpy"`; without `cache`.

    Returns:
        numba's dispatcher; a decorator if only options are given.
    """
    if function is None:
        return functools.partial(kernel, **options)
    compiled: Any = numba.njit(**options)(function)
    if hasattr(compiled, "_cache"):  # NUMBA_DISABLE_JIT leaves the function as it is
        compiled._cache = KernelCache(compiled)
    return compiled


class KernelCache(_Cache):
    """The compiled overloads of one kernel on disk; numba's dispatcher asks it before, and tells it after, a compile.

    Args:
        dispatcher: numba's dispatcher of the kernel.
    """

    def __init__(self, dispatcher: Dispatcher):
        self._dispatcher = dispatcher
        function = dispatcher.py_func
        self._name = ("%s.%s" % (function.__module__, function.__qualname__)).replace("<", "").replace(">", "")
        self._enabled = True

    @property
    def cache_path(self) -> str | None:
        """The folder of the cache, None where there is none."""
        return cache_folder()

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """The machine code for the argument types `sig`; None if it has to be compiled."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        try:
            with open(path, "rb") as file:
                stored, reduced = pickle.loads(file.read())
            if stored != sig:
                return None
            result = CompileResult._rebuild(target_context, *reduced)
        except FileNotFoundError:
            return None
        except Exception:  # a file that was cut off or altered is as good as none
            return None
        with contextlib.suppress(OSError):  # the time of its last use, for _prune
            os.utime(path)
        return result

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep freshly compiled machine code, if numba can keep it and a folder can be written."""
        path = self._path(sig, data.codegen)
        if path is None or data.library.has_dynamic_globals or not all(loop.can_cache for loop in data.lifted):
            return
        content = dumps((sig, data._reduce()))
        temporary = None
        try:
            handle, temporary = tempfile.mkstemp(".tmp", self._name + "-", os.path.dirname(path))
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, path)
            self._prune()
        except OSError:  # a full disk costs the next start a compile, not this one its result
            if temporary and os.path.exists(temporary):
                os.unlink(temporary)

    def enable(self) -> None:
        """Use the files."""
        self._enabled = True

    def disable(self) -> None:
        """Neither read nor write files."""
        self._enabled = False

    def flush(self) -> None:
        """Remove all files of this kernel."""
        for entry in self._files():
            os.unlink(entry.path)

    def _path(self, sig: Any, codegen: Any) -> str | None:
        folder = cache_folder() if self._enabled else None
        source = digest(self._dispatcher) if folder else None
        if folder is None or source is None:
            return None
        text = repr((source, sig, codegen.magic_tuple(), VERSIONS))
        return os.path.join(folder, "%s-%s.nbc" % (self._name, hashlib.sha256(text.encode()).hexdigest()[:32]))

    def _files(self) -> list[os.DirEntry]:
        folder = cache_folder()
        if folder is None:
            return []
        with os.scandir(folder) as entries:
            return [entry for entry in entries if entry.name.rpartition("-")[0] == self._name]

    def _prune(self) -> None:
        dated = []
        for entry in self._files():
            try:
                dated.append((entry.stat().st_mtime, entry.path))
            except FileNotFoundError:  # another process has removed it
                continue
        dated.sort(reverse=True)
        kept = [path for _, path in dated if path.endswith(".nbc")][:KEPT]
        newest = dated[0][0] if dated else 0.0
        for changed, path in dated:
            if path not in kept and (path.endswith(".nbc") or changed < newest - ABANDONED):
                try:
                    os.unlink(path)
                except FileNotFoundError:
                    continue


@functools.lru_cache(maxsize=None)
def cache_folder() -> str | None:
    """The folder for compiled kernels, made if it is missing; None if there is none that this user alone can write.

    Machine code from it is executed: a folder that another user could write, or owns, is not used.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    candidates = [
        os.path.join(home, "applr_ros1", "kernels"),
        os.path.join(tempfile.gettempdir(), "applr_ros1-kernels-%d" % os.getuid()),
    ]
    if os.environ.get("NUMBA_CACHE_DIR"):
        candidates.insert(0, os.path.abspath(os.path.join(os.environ["NUMBA_CACHE_DIR"], "applr_ros1")))
    for folder in filter(os.path.isabs, candidates):  # "~" stays where neither HOME nor the user's entry names a folder
        try:
            os.makedirs(folder, mode=0o700, exist_ok=True)
            state = os.lstat(folder)
            own = stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o022
            if own and os.access(folder, os.W_OK | os.X_OK):
                return folder
        except OSError:
            continue
    tried = ", ".join(candidates)
    warnings.warn("no folder for compiled kernels can be written (%s): every start compiles anew" % tried, stacklevel=2)
    return None
