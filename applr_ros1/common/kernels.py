"""Decorator `kernel`: numba's njit with machine code that is cached on disk between processes.

Every compiled function of the package uses the decorator. numba's own cache is keyed by the path of
the kernel's source file and checks that file alone. A second copy of the package therefore starts
without a cache, and changes in imported functions and constants go unnoticed. Here the key of a
cached file is a hash of the argument types, numba's version, the processor, and the sources of the
kernel's module and of all modules of this repository from which that module imports kernels or
constants. Editing a module recompiles its kernels and those of the modules that import from it.

The cache is the first of these folders that only this user can write, because machine code is
loaded from it: `NUMBA_CACHE_DIR`, `~/.cache`, or the folder for temporary files. If there is none,
or if the disk is full, each process compiles its kernels anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import pickle
import re
import stat
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Tuple, TypeVar, overload

import numba
from numba.core import serialize
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher

# limit on cached files (12 versions of all kernels); the least recently used are removed
KEPT_FILES = 6000
# numba has no types for these two functions.
dumps: Callable[[Any], bytes] = serialize.dumps
rebuild: Callable[..., CompileResult] = CompileResult._rebuild
# packages of this repository whose modules are hashed
OURS = ("applr_ros1", "sim_bridge", "worlds")
Result = TypeVar("Result")
# `import MODULE` or `from MODULE import NAMES`, whose names may stand in parentheses on several
# lines
IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)
COMMENT = re.compile(r" *#.*")


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
        numba's dispatcher, or a decorator if only options are given. Callers may pass numpy scalars
        for numbers, so the dispatcher's type declares only the result.
    """
    if function is None:
        return functools.partial(kernel, **options)
    dispatcher = numba.njit(**options)(function)
    dispatcher._cache = KernelCache(dispatcher)
    return dispatcher


class KernelCache(NullCache):
    """Disk cache of one kernel, for numba's dispatcher: a file for each tuple of argument types."""

    def __init__(self, dispatcher: Dispatcher):
        self._function = dispatcher.py_func
        # Files may be edited between the import and the first call.
        self._sources = _hash_of_sources(self._function.__module__)

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

    def _path(self, signature: Any, codegen: Any) -> Path:
        """Return the file of the machine code for a signature on this processor."""
        function = self._function
        type_names = [str(argument_type) for argument_type in getattr(signature, "args", signature)]
        target = sys.version_info[:2], numba.__version__, codegen.magic_tuple()
        cache_key = repr((target, type_names, self._sources)).encode()
        checksum = hashlib.sha256(cache_key).hexdigest()[:32]
        file_name = f"{function.__module__}.{function.__qualname__}-{checksum}"
        return Path(cache_folder(), file_name)


@functools.lru_cache(maxsize=None)
def _hash_of_sources(module: str) -> str:
    """Return a hash of the sources of a module and of all modules on which it depends."""
    source_hashes: Dict[str, str] = {}
    waiting_modules = [module]
    while waiting_modules:
        module_name = waiting_modules.pop()
        if module_name not in source_hashes:
            source_hashes[module_name], imported_modules = _source(module_name)
            waiting_modules += imported_modules
    return hashlib.sha256(repr(sorted(source_hashes.items())).encode()).hexdigest()


@functools.lru_cache(maxsize=None)
def _source(module: str) -> Tuple[str, List[str]]:
    """Return the hash of a module's source, and the modules that its kernels may use.

    Only modules of this repository count. Imported classes and plain functions do not, as kernels
    cannot use them.
    """
    loaded_module = sys.modules[module]
    source_text = Path(str(loaded_module.__file__)).read_text(encoding="utf-8")
    imported_modules = []
    for relative_name, listed_names in IMPORT.findall(source_text):
        names = COMMENT.sub("", listed_names).strip("()")
        base_module = importlib.util.resolve_name(relative_name, loaded_module.__package__)
        if base_module.partition(".")[0] not in OURS:
            continue
        if names:
            imported_modules += _modules_of(base_module, names, vars(loaded_module))
        else:
            imported_modules.append(base_module)
    return hashlib.sha256(source_text.encode()).hexdigest(), imported_modules


def _modules_of(base: str, names: str, namespace: Mapping[str, Any]) -> List[str]:
    """Return the modules of what `from BASE import NAMES` brings into a namespace for kernels.

    Args:
        base: Full name of the module or package.
        names: Text after `import`, such as "a, b as c".
        namespace: Global names of the importing module.
    """
    modules = []
    for import_item in names.split(","):
        words = import_item.split()  # NAME or NAME as ALIAS
        if words and _is_taken(namespace.get(words[-1])):
            full_name = f"{base}.{words[0]}"
            modules.append(full_name if full_name in sys.modules else base)
    return modules


def _is_taken(value: Any) -> bool:
    """Return whether kernels can use an imported value: a constant, a kernel or a NamedTuple."""
    return not callable(value) or isinstance(value, Dispatcher) or hasattr(value, "_fields")


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
