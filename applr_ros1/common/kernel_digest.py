"""A digest of everything that decides over a kernel's machine code, for the cache in kernels.py.

It covers the byte code of the kernel and of all functions that it reaches, through every module, and the values of the
globals that they name: numba takes those into the machine code as constants. Comments, docstrings and line numbers do
not count.
"""

from __future__ import annotations

import hashlib
import types
from typing import Any, Iterator

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher

NAMED = (type, np.ufunc, np.dtype, numba.types.Type, types.BuiltinFunctionType)  # told apart by their names
COMPILERS = ("numpy", "numba", "math", "cmath", "builtins", "operator")  # told apart by version, not by source


def digest(dispatcher: Dispatcher) -> str | None:
    """Digest of a kernel's code, the code of everything that it reaches, and the constants used on the way.

    Args:
        dispatcher: the kernel.

    Returns:
        64 hexadecimal digits; None if a global is of a kind whose value cannot be told, so that nothing may be kept.
    """
    sought = hashlib.sha256()
    reached, waiting = {id(dispatcher.py_func)}, [dispatcher]
    try:
        while waiting:
            for token in _tokens(waiting.pop()):
                if isinstance(token, str):
                    sought.update(token.encode() + b"\0")
                else:
                    function = getattr(token, "py_func", token)
                    sought.update(("-> %s.%s\0" % (function.__module__, function.__qualname__)).encode())
                    if id(function) not in reached:
                        reached.add(id(function))
                        waiting.append(token)
    except _Unknown:
        return None
    return sought.hexdigest()


class _Unknown(Exception):
    """A global whose value has no stable description."""


def _tokens(target: Any) -> Iterator[Any]:
    """What decides over a function's machine code: texts, and the functions (or dispatchers) that it calls."""
    function = target
    if isinstance(target, Dispatcher):
        function = target.py_func
        yield "%s.%s %r" % (function.__module__, function.__qualname__, sorted(target.targetoptions.items()))
    for cell in function.__closure__ or ():
        yield from _value(cell.cell_contents, ())
    yield from _value(function.__defaults__, ())
    yield from _code(function.__code__, function.__globals__, function.__doc__)


def _code(code: types.CodeType, names: dict, doc: str | None = None) -> Iterator[Any]:
    yield "code %s %d %d" % (code.co_code.hex(), code.co_argcount, code.co_flags)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code(constant, names)
        elif constant is None or constant != doc:
            yield from _value(constant, ())
    for name in code.co_names:
        yield "name " + name
        if name in names:
            yield from _value(names[name], code.co_names)


def _value(value: Any, attributes: tuple[str, ...]) -> Iterator[Any]:
    """Describe a constant, or name a function; `attributes` are the names that the code may look up in a module."""
    module = str(getattr(value, "__module__", "") or "").partition(".")[0]
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes, slice, type(Ellipsis))):
        yield "%s %r" % (type(value).__name__, value)
    elif isinstance(value, (tuple, list)):
        yield "%s of %d" % (type(value).__name__, len(value))
        for part in value:
            yield from _value(part, ())
    elif isinstance(value, frozenset):
        yield "frozenset %r" % sorted(map(repr, value))
    elif isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
        yield "array %s %s %s" % (value.dtype.descr, value.shape, np.asarray(value).tobytes().hex())
    elif isinstance(value, Dispatcher) or (isinstance(value, types.FunctionType) and module not in COMPILERS):
        yield value
    elif isinstance(value, types.ModuleType):
        yield "module " + value.__name__
        if value.__name__.partition(".")[0] not in COMPILERS:
            for name in attributes:
                if name in vars(value):
                    yield from _value(vars(value)[name], tuple(other for other in attributes if other != name))
    elif isinstance(value, NAMED) or module in COMPILERS:
        name = getattr(value, "__qualname__", repr(value))
        yield "%s %s %s" % (getattr(value, "__module__", ""), name, getattr(value, "_fields", ""))
    else:
        raise _Unknown(type(value).__name__)
