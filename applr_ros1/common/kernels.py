"""Decorator `kernel`: numba's njit with machine code that is cached on disk between processes.

Every compiled function of the package uses the decorator. numba's own cache is keyed by the path of the kernel's source
file and checks that file alone. A second copy of the package therefore starts without a cache, and changes in imported
functions and constants go unnoticed. Here the key of a cached file is a hash of the argument types, numba's version,
the processor, and the sources of the kernel's module and of all modules of this repository from which that module
imports kernels or constants. Editing a module recompiles its kernels and those of the modules that import from it.

The cache is the first of these folders that only this user can write, because machine code is loaded from it:
`NUMBA_CACHE_DIR`, `~/.cache`, or the folder for temporary files. If there is none, or if the disk is full, each process
compiles its kernels anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import pickle
import re
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any, Callable, List, Tuple, TypeVar, overload

import numba
from numba.core import serialize
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher

KEPT_FILES = 6000  # limit on cached files (12 versions of all kernels); the least recently used are removed
dumps: Callable[[Any], bytes] = serialize.dumps  # numba has no types for this function and `_rebuild`
rebuild: Callable[..., CompileResult] = CompileResult._rebuild
OURS = ("applr_ros1", "sim_bridge", "worlds")  # packages of this repository whose modules are hashed
Result = TypeVar("Result")
IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +\(?(.*))?", re.MULTILINE)


@overload
def kernel(function: Callable[..., Result]) -> Callable[..., Result]: ...
@overload
def kernel(**options: Any) -> Callable[[Callable[..., Result]], Callable[..., Result]]: ...
def kernel(function: Any = None, **options: Any) -> Any:
    """Compile `function` with numba.njit and cache the machine code.

    Args:
        function: Python function that numba can compile, at the top level of a module.
        options: Options of numba.njit except `cache`, for example `error_model="numpy"`.

    Returns:
        numba's dispatcher, or a decorator if only options are given. Callers may pass numpy scalars for numbers, so the
        dispatcher's type declares only the result.
    """
    if function is None:
        return functools.partial(kernel, **options)
    made = numba.njit(**options)(function)
    made._cache = KernelCache(made)
    return made


class KernelCache(NullCache):
    """Disk cache of one kernel, for numba's dispatcher: a file for each tuple of argument types."""

    def __init__(self, dispatcher: Dispatcher):
        self._function = dispatcher.py_func
        self._sources = _hash_of_sources(self._function.__module__)  # Files may be edited before the first call.

    @property
    def cache_path(self) -> str:
        """Folder of the cache; "" if there is none."""
        return cache_folder()

    def load_overload(self, signature: Any, target_context: Any) -> CompileResult | None:
        """Return the cached compilation for these types, or None if it is missing or damaged."""
        target_context.refresh()
        if not cache_folder():
            return None
        path = self._path(signature, target_context.codegen())
        try:
            parts = pickle.loads(path.read_bytes())
            os.utime(path)  # _remove_unused sorts by the time of the last use.
        except Exception:  # Unpickling a damaged file may raise any exception.
            return None
        return rebuild(target_context, *parts)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Write a compilation to the cache. Other processes see the file only when it is complete."""
        if not cache_folder() or data.library.has_dynamic_globals:
            return
        path = self._path(signature, data.library.codegen)
        with contextlib.suppress(OSError):
            partial = Path(f"{path}.{os.getpid()}")
            partial.write_bytes(dumps(data._reduce()))
            os.replace(partial, path)
            _remove_unused()

    def _path(self, signature: Any, codegen: Any) -> Path:
        function = self._function
        types = [str(kind) for kind in getattr(signature, "args", signature)]
        target = sys.version_info[:2], numba.__version__, codegen.magic_tuple()
        key = repr((target, types, self._sources)).encode()
        name = f"{function.__module__}.{function.__qualname__}-{hashlib.sha256(key).hexdigest()[:32]}"
        return Path(cache_folder(), name)


@functools.lru_cache(maxsize=None)
def _hash_of_sources(module: str) -> str:
    """Return a hash of the sources of a module and of all modules on which it depends."""
    sources, waiting = {}, [module]
    while waiting:
        name = waiting.pop()
        if name not in sources:
            sources[name], imported = _source(name)
            waiting += imported
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()


@functools.lru_cache(maxsize=None)
def _source(module: str) -> Tuple[str, List[str]]:
    """Return the hash of a module's source, and the modules from which it imports kernels or constants.

    Only modules of this repository count. Imported classes and plain functions do not, as kernels cannot use them.
    """
    loaded = sys.modules[module]
    text = Path(str(loaded.__file__)).read_text(encoding="utf-8")
    imported = []
    for base, names in IMPORT.findall(text):
        base = importlib.util.resolve_name(base, loaded.__package__)
        words = [name.split() for name in names.split(",") if name.strip()]
        taken = [first for first, *_, last in (w * 2 for w in words) if _is_taken(vars(loaded).get(last))]
        sources = [name if name in sys.modules else base for name in (f"{base}.{first}" for first in taken)]
        imported += [name for name in (sources if words else [base]) if name.partition(".")[0] in OURS]
    return hashlib.sha256(text.encode()).hexdigest(), imported


def _is_taken(value: Any) -> bool:
    return not callable(value) or isinstance(value, Dispatcher) or hasattr(value, "_fields")


@functools.lru_cache(maxsize=None)
def cache_folder() -> str:
    """Return the folder of the cache, created if missing, or "" if there is none that only this user can write."""
    places = [
        os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "applr_ros1"),
        os.path.join(os.environ.get("TMPDIR") or "/tmp", f"applr_ros1-{os.getuid()}"),
    ]
    if os.environ.get("NUMBA_CACHE_DIR"):
        places.insert(0, os.path.abspath(os.path.join(os.environ["NUMBA_CACHE_DIR"], "applr_ros1")))
    for place in filter(os.path.isabs, places):  # expanduser keeps "~" if the user has no home folder.
        with contextlib.suppress(OSError):
            os.makedirs(place, mode=0o700, exist_ok=True)
            entry = os.stat(place)
            if entry.st_uid != os.getuid() or entry.st_mode & 0o022:
                continue
            tempfile.TemporaryFile(dir=place).close()
            return place
    problem = f"no folder for compiled kernels can be written ({', '.join(places)})"
    warnings.warn(f"{problem}: every start recompiles, set NUMBA_CACHE_DIR to a folder of your own", stacklevel=2)
    return ""


@functools.lru_cache(maxsize=None)
def _remove_unused() -> None:
    """Remove the least recently used files beyond KEPT_FILES. Runs once per process."""
    files = sorted(os.scandir(cache_folder()), key=lambda entry: -entry.stat().st_mtime)
    for old in files[KEPT_FILES:]:
        os.unlink(old.path)
