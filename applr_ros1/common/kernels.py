"""The decorator `kernel`: numba's njit with machine code that is kept on disk between processes.

Every compiled function of the package carries it. numba's own cache goes by the path of the file in which a kernel
stands and compares that file alone: it is cold in every other folder, and a change in a function or constant that the
kernel takes from another file goes unnoticed. Here the name of a file of machine code is a hash of what is compiled:
the bytecode of the kernel and of every function that it reaches, the values of the constants that they take, the types
of the arguments, numba's version and the processor. Neither a path nor a date nor a comment counts. Processes that need
the same kernel at once wait for the one that compiles it.

The files lie in `NUMBA_CACHE_DIR`, in `~/.cache`, or in the folder for temporary files: the first of them in which
this user alone can write, since machine code is loaded from it. Without any, or where the disk is full, each process
compiles anew.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import os
import pickle
import sys
import tempfile
import time
import warnings
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Callable, Iterator, List, Tuple

import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

KEPT_FILES = 6000  # of machine code, a dozen versions of all kernels; beyond, those unused longest are removed
LOCKED_S = 120.0  # of wall time that a process waits for another one that compiles the same kernel
FOREIGN = ("math", "numpy", "numba")  # modules whose functions numba brings itself


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile `function` with numba.njit and keep the machine code.

    Args:
        function: the Python function, in the subset of the language that numba compiles. A constant that it takes is
            a number, a string, an array, or a tuple of these; what it is at the first compilation stays.
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
        self._dispatcher = dispatcher

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
        parts = _read(path)
        if parts is None and _lock(path):  # then another process may have compiled it
            parts = _read(path)
        if parts is None:
            return None
        _unlock(path)
        return CompileResult._rebuild(target_context, *parts)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep a compilation; what cannot be written costs a warning."""
        if not cache_folder() or data.library.has_dynamic_globals:
            return
        path = self._path(signature, data.library.codegen)
        try:
            with _written_whole(path) as file:
                file.write(dumps(data._reduce()))
            _remove_unused()
        except OSError as problem:
            _warn_once(f"{cache_folder()}: cannot keep compiled kernels ({problem})")
        _unlock(path)

    def _path(self, signature: Any, codegen: Any) -> str:
        arguments = getattr(signature, "args", signature)
        target = (sys.version_info[:2], numba.__version__, codegen.magic_tuple())
        key = hashlib.sha256(repr(target).encode())
        for text in (*map(_type_text, arguments), self._content):
            key.update(text.encode() + b"\0")
        function = self._dispatcher.py_func
        return os.path.join(cache_folder(), f"{function.__module__}.{function.__name__}-{key.hexdigest()[:32]}")

    @functools.cached_property
    def _content(self) -> str:
        """The text of the kernel, then those of all functions that it reaches; when all of them are defined."""
        texts, waiting = {}, [self._dispatcher]
        while waiting:
            function = waiting.pop()
            if function not in texts:
                texts[function], taken = _function_text(function)
                waiting += taken
        own = texts.pop(self._dispatcher)
        return "\n".join([own, *sorted(texts.values())])


@functools.lru_cache(maxsize=None)
def _function_text(function: Any) -> Tuple[str, List[Any]]:
    """Return all that numba compiles of a kernel or function by itself, and the functions that it takes."""
    python = getattr(function, "py_func", function)
    code: CodeType = python.__code__
    taken: List[Any] = []
    names = {**python.__globals__, **dict(zip(code.co_freevars, (c.cell_contents for c in python.__closure__ or ())))}
    used = sorted(_names(code))
    values = [f"{name}={_value_text(names[name], used, taken)}" for name in used if name in names]
    options = sorted(getattr(function, "targetoptions", {}).items())
    head = f"{python.__module__}.{python.__qualname__} {options} {_value_text(python.__defaults__, used, taken)}"
    return "\n".join([head, _code_text(code, python.__doc__), *values]), taken


def _names(code: CodeType) -> Iterator[str]:
    yield from (*code.co_names, *code.co_freevars)
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)


def _code_text(code: CodeType, docstring: Any) -> str:
    constants = code.co_consts[code.co_consts[:1] == (docstring,) :]
    shown = [_code_text(value, "") if isinstance(value, CodeType) else repr(value) for value in constants]
    signature = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return repr((code.co_code, getattr(code, "co_exceptiontable", b""), signature, names, shown))


def _value_text(value: Any, names: List[str], taken: List[Any], within: Tuple[Any, ...] = ()) -> str:
    """Return what a kernel takes by a name; of a module what it may take by one of `names`. Functions go to `taken`."""
    if isinstance(value, (Dispatcher, FunctionType)):
        taken.append(value)
        python: Any = getattr(value, "py_func", value)
        return f"{python.__module__}.{python.__qualname__}"
    if isinstance(value, ModuleType):
        if value.__name__.partition(".")[0] in FOREIGN or value in within:
            return value.__name__
        inside = {name: vars(value)[name] for name in names if name in vars(value)}
        texts = [f"{name}={_value_text(inner, names, taken, (*within, value))}" for name, inner in inside.items()]
        return f"{value.__name__} {texts}"
    if isinstance(value, tuple):
        return f"{type(value)}{[_value_text(inner, names, taken) for inner in value]}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.strides} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, (bool, int, float, complex, str, bytes, type(None), np.generic, np.dtype, numba.types.Type)):
        return f"{type(value)} {value!r}"
    if isinstance(value, type) and (hasattr(value, "_fields") or issubclass(value, (int, float, np.generic))):
        return f"{value} {getattr(value, '_fields', ())}"
    if isinstance(value, (BuiltinFunctionType, np.ufunc)):
        return f"{type(value)} {value.__name__}"
    raise TypeError(
        f"a kernel takes {value!r}, a {type(value).__name__}: give it a number, a tuple or an array instead"
    )


def _type_text(kind: Any) -> str:
    """Return the name of a type of numba with what the name leaves out: classes and fields of named tuples."""
    inner = (
        *getattr(kind, "types", ()),
        *(getattr(kind, n, None) for n in ("dtype", "type", "key_type", "value_type")),
    )
    inside = [_type_text(part) for part in inner if isinstance(part, numba.types.Type)]
    return f"{kind} {getattr(kind, 'instance_class', '')} {getattr(kind, 'fields', '')} {inside}"


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
    _warn_once(f"no folder for compiled kernels can be written ({', '.join(places)})")
    return ""


@functools.lru_cache(maxsize=None)  # numba forgets what Python has warned of
def _warn_once(what: str) -> None:
    warnings.warn(f"{what}: every start compiles anew", stacklevel=3)


def _read(path: str) -> Any:
    """Return what save_overload has written; None if there is none, or no whole one."""
    try:
        with open(path, "rb") as file:
            parts = pickle.load(file)
        os.utime(path)  # the time of its last use
    except Exception:  # besides OSError whatever half a file makes of unpickling
        return None
    return parts


@functools.lru_cache(maxsize=None)
def _lock_file() -> int:
    return os.open(os.path.join(cache_folder(), "lock"), os.O_RDWR | os.O_CREAT, 0o600)


def _lock(path: str) -> bool:
    """Wait while another process compiles this kernel; a byte of the lock file stands for it until `_unlock`."""
    deadline = time.monotonic() + LOCKED_S
    while time.monotonic() < deadline:
        try:
            fcntl.lockf(_lock_file(), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _byte(path))
            return True
        except BlockingIOError:
            time.sleep(0.02)
        except OSError:  # a file system without locks
            break
    return False


def _unlock(path: str) -> None:
    with contextlib.suppress(OSError):
        fcntl.lockf(_lock_file(), fcntl.LOCK_UN, 1, _byte(path))


def _byte(path: str) -> int:
    return int(path[-12:], 16)


@contextlib.contextmanager
def _written_whole(path: str) -> Iterator[Any]:
    """Open a file that other processes see when all is written."""
    with tempfile.NamedTemporaryFile(dir=os.path.dirname(path), delete=False) as file:
        try:
            yield file
            file.flush()
            os.replace(file.name, path)
        except BaseException:
            os.unlink(file.name)
            raise


@functools.lru_cache(maxsize=None)
def _remove_unused() -> None:
    """Remove what was unused longest, once in a process that has compiled something."""
    files = sorted(os.scandir(cache_folder()), key=lambda entry: -entry.stat().st_mtime)
    for old in files[KEPT_FILES:]:
        with contextlib.suppress(OSError):
            os.unlink(old.path)
