"""Decorator `kernel`: numba's njit at the first call, with machine code that is cached on disk.

Every compiled function of the package uses the decorator. numba itself is imported when the first
kernel runs: it costs more than everything else that `--help` of a command imports.

numba's own cache is keyed by the path of the kernel's source file and checks that file alone. A
second copy of the package therefore starts without a cache, and changes in imported functions and
constants go unnoticed. Here (kernel_cache.py) the key of a cached file is a hash of the argument
types, numba's version, the processor, and the sources of this module, the kernel's module and all
modules of this repository from which that module imports kernels or constants. Editing a module
recompiles its kernels and those of the modules that import from it.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import re
import sys
import threading
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Tuple, TypeVar, overload

# packages of this repository whose modules are hashed
OURS = ("applr_ros1", "sim_bridge", "worlds")
Result = TypeVar("Result")
# `import MODULE` or `from MODULE import NAMES`, whose names may stand in parentheses on several
# lines
IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)
COMMENT = re.compile(r" *#.*")
# Nodes call kernels from several threads, and cached_property has no lock from Python 3.12 on. A
# second dispatcher would compile everything again.
_MAKES_DISPATCHER = threading.Lock()


@overload
def kernel(function: Callable[..., Result]) -> Callable[..., Result]: ...
@overload
def kernel(**options: Any) -> Callable[[Callable[..., Result]], Callable[..., Result]]: ...
def kernel(function: Any = None, **options: Any) -> Any:
    """Compile `function` with numba.njit when it is first called, and cache the machine code.

    Args:
        function: Python function that numba can compile, at the top level of a module.
        options: Options of numba.njit except `cache`, for example `error_model="numpy"`.

    Returns:
        The Kernel, or a decorator if only options are given. Callers may pass numpy scalars for
        numbers, so the type declares only the result.
    """
    if function is None:
        return functools.partial(kernel, **options)
    return Kernel(function, options)


class Kernel:
    """A compiled function, whose dispatcher is made by the first call from Python or a kernel.

    Attributes:
        py_func: The function as Python runs it.
        targetoptions: Options of numba.njit. While numba compiles a kernel that calls this one, it
            asks for them under this name, to find out whether to inline the function.
    """

    def __init__(self, function: Callable[..., Any], options: Mapping[str, Any]):
        functools.update_wrapper(self, function)
        self.py_func = function
        self.targetoptions = options
        # Files may be edited between the import and the first call.
        self._sources = _hash_of_sources(function.__module__)

    # Arguments have no names here: each call would pay for an empty dict, 50 ns.
    def __call__(self, *arguments: Any) -> Any:
        """Return the result of the compiled function."""
        return self.dispatcher(*arguments)

    def __reduce__(self) -> str:
        """Pickle the kernel as the name under which its module has it."""
        return self.py_func.__qualname__

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Dispatcher of numba, which compiles for each tuple of argument types."""
        import numba

        from applr_ros1.common.kernel_cache import KernelCache

        with _MAKES_DISPATCHER:
            if "dispatcher" not in vars(self):
                dispatcher = numba.njit(**self.targetoptions)(self.py_func)
                dispatcher._cache = KernelCache(self.py_func, self._sources)
                vars(self)["dispatcher"] = dispatcher
        return vars(self)["dispatcher"]

    @property
    def _numba_type_(self) -> Any:
        """Type by which numba finds the dispatcher while it compiles a kernel that calls this one.

        numba's typeof asks every object of an unknown class for this attribute.
        """
        import numba

        return numba.types.Dispatcher(self.dispatcher)


@functools.lru_cache(maxsize=None)
def _hash_of_sources(module: str) -> str:
    """Return a hash of the sources of a module and of all modules on which it depends."""
    source_hashes: Dict[str, str] = {}
    # This module decides with which options a kernel is compiled, and which ones are inlined.
    waiting_modules = [module, __name__]
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
    return not callable(value) or isinstance(value, Kernel) or hasattr(value, "_fields")
