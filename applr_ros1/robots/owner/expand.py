"""Expands a xacro file without running code of it: in a process with limits, by an evaluator that only calculates.

xacro's own eval() does not look inside comprehensions. Here no Python is made of an expression: its syntax tree is
walked, and what is neither arithmetic nor comparison, nor a function named below, is refused. The process can write no
file, and ends when it has used LIMITS; `expand` starts this file as its program.
"""

from __future__ import annotations

import ast
import contextlib
import json
import math
import operator
import sys
import types
from typing import Any, Callable, Dict, List, Mapping, Set, Tuple

from applr_ros1.common import child
from applr_ros1.common.errors import ApplrError, reason

LIMITS = {"CPU": 5, "AS": 2**30, "FSIZE": 0, "NPROC": 0}  # s, bytes, bytes of a file that it writes, more processes
PATIENCE = 30.0  # s; a file that it includes may be a pipe
MAX_TEXT = 16 * 2**20  # characters of a URDF
REMEDY = "; if you trust the file, give what this writes: xacro {} > robot.urdf"

_OPERATORS: Dict[type, Callable[..., Any]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv},
    **{ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod, ast.Pow: operator.pow},
    **{ast.Not: operator.not_, ast.UAdd: operator.pos, ast.USub: operator.neg},
    **{ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le},
    **{ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not},
    **{ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b},
}
_OF_PYTHON = (abs, all, any, bool, dict, float, int, len, list, max, min, range, round, sorted, str, sum, tuple)
_OF_MATH = {name: value for name, value in vars(math).items() if not name.startswith("_")}
_OF_TEXT = ("endswith", "lower", "lstrip", "replace", "rstrip", "split", "startswith", "strip", "upper")
_OF_XACRO = ("abs_filename", "arg", "dotify", "error", "fatal", "load_yaml", "message", "tokenize", "warning")


def expand(path: str, arguments: Mapping[str, str], packages: Mapping[str, str]) -> Tuple[str, str, Set[str]]:
    """(URDF, what is wrong in one line or "", names of packages that are not there) of a xacro file.

    Args:
        path: The file.
        arguments: Of the xacro file, by name.
        packages: Folders of ROS packages, by name.
    """
    answer = child.run([__file__, path], {"arguments": dict(arguments), "packages": dict(packages)}, LIMITS, PATIENCE)
    if not answer:
        problem = f"it takes over {LIMITS['CPU']} s or {LIMITS['AS'] // 2**20} MB" + REMEDY.format(path)
        return "", problem, set()
    text, problem, missing = json.loads(answer)
    return text, problem, set(missing)


def _program() -> List[Any]:
    """Expands the file of the command line."""
    import xacro
    from xacro import substitution_args

    path, given = sys.argv[1], child.taken()
    missing: List[str] = []

    def folder(name: str) -> str:
        """Where there is none, a pattern: an include that matches nothing is left out, as of a sensor not there."""
        if name not in given["packages"]:
            missing.append(name)
        return str(given["packages"].get(name, f"/there is no package [{name}]"))

    def of_xacro(text: str, names: Dict[str, Any], _: Any = None) -> Any:
        functions = {name: xacro._global_symbols["xacro"][name] for name in _OF_XACRO}
        return _evaluate(text, names, {**functions, **{f"xacro.{name}": f for name, f in functions.items()}})

    def of_eval(text: str, context: Dict[str, Any]) -> str:
        values = {name: substitution_args.convert_value(value, "auto") for name, value in context["arg"].items()}
        return str(_evaluate(text, {**_OF_MATH, "true": True, "false": False, **values}, {}))

    index: Any = types.ModuleType("ament_index_python.packages")  # where xacro asks for packages
    index.get_package_share_directory = folder
    sys.modules.update({"ament_index_python": types.ModuleType("ament_index_python"), index.__name__: index})
    xacro.safe_eval, substitution_args._eval = of_xacro, of_eval
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a file has to say, which can be endless
            text = xacro.process_file(path, mappings=given["arguments"]).toxml()
    except Exception as error:  # what a file of expressions raises can be anything
        cause = getattr(error, "exc", None) or error
        if isinstance(cause, (MemoryError, RecursionError)):
            cause = ApplrError(f"it is nested too deep or too large ({type(cause).__name__})" + REMEDY.format(path))
        return ["", reason(cause if isinstance(cause, ApplrError) else error) or type(error).__name__, missing]
    too_large = f"it grows to {len(text)} characters" + REMEDY.format(path) if len(text) > MAX_TEXT else ""
    return ["" if too_large else text, too_large, missing]


def _evaluate(text: str, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """The value of an expression, in which these names and functions are known, and those of math and _OF_PYTHON."""
    known: Dict[str, Any] = {f.__name__: f for f in _OF_PYTHON}
    known.update((name, f) for name, f in _OF_MATH.items() if callable(f))
    known.update([(f"{module}.{name}", f) for name, f in known.items() for module in ("math", "python")])
    known.update(functions)

    def value(node: Any) -> Any:
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return names[node.id]
        if isinstance(node, ast.Attribute):
            held = value(node.value)
            if isinstance(held, dict):  # a namespace, or read from YAML
                return held[node.attr]
        if isinstance(node, ast.Subscript):
            return value(node.value)[value(node.slice)]
        if isinstance(node, ast.Slice):
            return slice(*(end and value(end) for end in (node.lower, node.upper, node.step)))
        if isinstance(node, (ast.List, ast.Tuple)):
            items = [value(item) for item in node.elts]
            return items if isinstance(node, ast.List) else tuple(items)
        if isinstance(node, ast.Dict) and None not in node.keys:
            return {value(key): value(item) for key, item in zip(node.keys, node.values)}
        if isinstance(node, ast.IfExp):
            return value(node.body if value(node.test) else node.orelse)
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
            return _OPERATORS[type(node.op)](value(node.operand))
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            return _OPERATORS[type(node.op)](value(node.left), value(node.right))
        if isinstance(node, ast.BoolOp):
            result = None
            for operand in node.values:
                result = value(operand)
                if bool(result) == isinstance(node.op, ast.Or):
                    break
            return result
        if isinstance(node, ast.Compare):
            terms = [value(term) for term in (node.left, *node.comparators)]
            return all(_OPERATORS[type(op)](a, b) for op, a, b in zip(node.ops, terms, terms[1:]))
        if isinstance(node, ast.Call) and all(keyword.arg not in (None, "key") for keyword in node.keywords):
            function = known.get(ast.unparse(node.func))
            if isinstance(node.func, ast.Attribute) and node.func.attr in _OF_TEXT:
                held = value(node.func.value)
                function = getattr(held, node.func.attr) if isinstance(held, str) else None
            if function:
                named = {str(keyword.arg): value(keyword.value) for keyword in node.keywords}
                return function(*(value(argument) for argument in node.args), **named)
        raise ApplrError(f"{ast.unparse(node)[:80]} is more than arithmetic" + REMEDY.format(sys.argv[1]))

    try:
        return value(ast.parse(text.strip(), mode="eval").body)
    except KeyError as unknown:
        raise NameError(f"name {unknown} is not defined") from None


if __name__ == "__main__":
    json.dump(_program(), sys.stdout)
