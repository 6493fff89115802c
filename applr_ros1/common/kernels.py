"""The decorator `kernel`: numba's njit with machine code that is kept on disk between processes.

Every compiled function of the package carries it. numba's own cache goes by the path of the file in which a kernel
stands and compares that file alone: it is cold in every other folder, and a change in a function or constant that the
kernel takes from another file goes unnoticed. Here the name of a file of machine code is a hash of the source of the
kernel's module and of all modules of ours from which it imports kernels or constants, the types of the arguments,
numba's version and the processor. An edited module has its kernels compiled anew, and those of the modules that take
something from it.

The files lie in `NUMBA_CACHE_DIR`, in `~/.cache`, or in the folder for temporary files: the first of them in which
this user alone can write, since machine code is loaded from it. Without any, or if the disk is full, each process
compiles anew.
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
from typing import Any, Callable, List, Tuple

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

KEPT_FILES = 6000  # files of machine code, a dozen versions of all kernels; beyond, the longest unused are removed
OURS = ("applr_ros1", "sim_bridge", "worlds")  # packages whose modules are hashed
IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +\(?(.*))?", re.MULTILINE)


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile `function` with numba.njit and keep the machine code.

    Args:
        function: the Python function, in the subset of the language that numba compiles, at the top level of a module.
        options: those of numba.njit, for instance `error_model="numpy"`; without `cache`.

    Returns:
        numba's dispatcher; a decorator if only options are given.
    """
    if function is None:
        return functools.partial(kernel, **options)
    made = numba.njit(**options)(function)
    made._cache = KernelCache(made)
    return made


class KernelCache(NullCache):
    """The machine code of one kernel: a file for each tuple of argument types. numba's dispatcher asks it."""

    def __init__(self, dispatcher: Dispatcher):
        self._function = dispatcher.py_func
        self._sources = _hash_of_sources(self._function.__module__)  # now: an edit may come before the first call

    @property
    def cache_path(self) -> str:
        """The folder of the files; "" without any."""
        return cache_folder()

    def load_overload(self, signature: Any, target_context: Any) -> CompileResult | None:
        """Return the kept compilation for these types; None if there is none, or no whole one."""
        target_context.refresh()
        if not cache_folder():
            return None
        path = self._path(signature, target_context.codegen())
        try:
            parts = pickle.loads(path.read_bytes())
            os.utime(path)  # the time of its last use
        except Exception:  # besides OSError whatever half a file makes of unpickling
            return None
        return CompileResult._rebuild(target_context, *parts)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep a compilation in a file that other processes see when all is written."""
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
    """Return a hash of the sources of a module and of all modules that it depends on (_source)."""
    sources, waiting = {}, [module]
    while waiting:
        name = waiting.pop()
        if name not in sources:
            sources[name], imported = _source(name)
            waiting += imported
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()


@functools.lru_cache(maxsize=None)
def _source(module: str) -> Tuple[str, List[str]]:
    """Return the hash of the source of a module, and the modules of ours from which it imports what kernels can take.

    A class or a function that is no kernel cannot be compiled, so its module does not count.
    """
    loaded = sys.modules[module]
    text = Path(str(loaded.__file__)).read_text(encoding="utf-8")
    imported = []
    for base, names in IMPORT.findall(text):
        base = importlib.util.resolve_name(base, loaded.__package__)
        words = [name.split() for name in names.split(",") if name.strip()]
        taken = [first for first, *_, last in (w * 2 for w in words) if _is_taken(vars(loaded).get(last))]
        found = [name if name in sys.modules else base for name in (f"{base}.{first}" for first in taken)]
        imported += [name for name in (found if words else [base]) if name.partition(".")[0] in OURS]
    return hashlib.sha256(text.encode()).hexdigest(), imported


def _is_taken(value: Any) -> bool:
    return not callable(value) or isinstance(value, Dispatcher) or hasattr(value, "_fields")


@functools.lru_cache(maxsize=None)
def cache_folder() -> str:
    """Return the folder for machine code, made if missing; "" if none is this user's alone."""
    places = [
        os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "applr_ros1"),
        os.path.join(os.environ.get("TMPDIR") or "/tmp", f"applr_ros1-{os.getuid()}"),
    ]
    if os.environ.get("NUMBA_CACHE_DIR"):
        places.insert(0, os.path.abspath(os.path.join(os.environ["NUMBA_CACHE_DIR"], "applr_ros1")))
    for place in filter(os.path.isabs, places):  # "~" stays where neither HOME nor the user's entry names a folder
        with contextlib.suppress(OSError):
            os.makedirs(place, mode=0o700, exist_ok=True)
            entry = os.stat(place)
            if entry.st_uid != os.getuid() or entry.st_mode & 0o022:
                continue
            tempfile.TemporaryFile(dir=place).close()
            return place
    what = f"no folder for compiled kernels can be written ({', '.join(places)}): every start compiles anew"
    warnings.warn(what, stacklevel=2)
    return ""


@functools.lru_cache(maxsize=None)
def _remove_unused() -> None:
    """Remove what was unused longest, once in a process that has compiled something."""
    files = sorted(os.scandir(cache_folder()), key=lambda entry: -entry.stat().st_mtime)
    for old in files[KEPT_FILES:]:
        os.unlink(old.path)
