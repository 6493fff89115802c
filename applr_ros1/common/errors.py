"""Base class of the project's exceptions, and wrappers that turn exceptions into one line."""

from __future__ import annotations

import difflib
import importlib
import os
import reprlib
import signal
import sys
import traceback
from typing import Any, Callable, Iterable, Mapping, NoReturn, Optional

from applr_ros1.common.extras import absent

LEAST_LIKENESS = 0.75  # smallest similarity of a name that is suggested (difflib's ratio, 0 to 1)
# What to give instead of a value, by pydantic's type of the error. The names are those of its ctx.
_REMEDIES = {
    **dict.fromkeys(("float_type", "float_parsing"), "give a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "give a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "give true or false"),
    **dict.fromkeys(("tuple_type", "list_type"), "give a list"),
    **dict.fromkeys(("dict_type", "model_type"), "give lines such as name: value"),
    "finite_number": "give a finite number",
    "string_type": "give a text",
    "string_pattern_mismatch": "give a name without blanks and special characters",
    "string_too_short": "give a longer text",
    "literal_error": "give {expected}",
    "greater_than": "give more than {gt}",
    "greater_than_equal": "give at least {ge}",
    "less_than": "give less than {lt}",
    "less_than_equal": "give at most {le}",
    "too_short": "give at least {min_length} values",
    "too_long": "give at most {max_length} values",
    "missing": "give it",
}
LONGEST_VALUE = 80  # largest number of characters of a value in a message
_SHORT = reprlib.Repr()
_SHORT.maxlevel = 3
_SHORT.maxstring = 60
_SHORT.maxother = 60


class ApplrError(ValueError):
    """An error that the user can correct. Its text is one line: problem, value, remedy."""


def did_you_mean(name: Any, known: Iterable[str]) -> str:
    """Return "did you mean NAME?" with the known name closest to `name`, or "" if none is close."""
    close_names = difflib.get_close_matches(str(name), list(known), 1, LEAST_LIKENESS)
    return f"did you mean {close_names[0]}?" if close_names else ""


def shown(value: Any) -> str:
    """Return a user's value for a message, shortened to LONGEST_VALUE characters.

    The text of a huge value is never made as a whole, which could take all memory.
    """
    value_text = _SHORT.repr(value)
    if len(value_text) <= LONGEST_VALUE:
        return value_text
    return value_text[:LONGEST_VALUE] + "..."


def remedy_of(problem: Mapping[str, Any]) -> str:
    """Return what to give instead of a value that pydantic refused, in this project's words.

    Rules of this project, which name problem and remedy themselves, are returned as they are.

    Args:
        problem: Entry of ValidationError.errors().
    """
    if problem["type"] == "value_error":
        return str(problem["ctx"]["error"])
    remedy = _REMEDIES.get(problem["type"], "give another value")
    return remedy.format(**problem.get("ctx", {}))


def reason(error: BaseException) -> str:
    """Return the description of an error in one line, without error number and path."""
    description = getattr(error, "strerror", None)  # Errors of the operating system have it.
    if description:
        return str(description)
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__


def one_line(error: BaseException) -> str:
    """Return an error as one line.

    An ApplrError is its text. Any other error has its type, text, file and line, for example
    "KeyError: 'v' (my_method.py, line 9)".
    """
    if isinstance(error, ApplrError):
        return str(error)
    description = f"{type(error).__name__}: {error}".splitlines()[0]
    stack_frames = traceback.extract_tb(error.__traceback__)
    # The text of a SyntaxError already has file and line.
    if not stack_frames or isinstance(error, SyntaxError):
        return description
    raised_in = stack_frames[-1]
    return f"{description} ({os.path.basename(raised_in.filename)}, line {raised_in.lineno})"


def run_main(main: Callable[[], Optional[int]], program: str) -> int:
    """Run a command and return its exit status.

    Every error becomes one line "PROGRAM: ..." on stderr and exit status 1. Ctrl-C gives exit
    status 130 and the text of the KeyboardInterrupt if it has one. The environment variable
    APPLR_DEBUG adds the traceback.

    Args:
        main: The command; returns an exit status, or None for 0.
        program: Name of the program as the user typed it, for example "./applr evaluate".
    """
    try:
        exit_status = main() or 0
        sys.stdout.flush()
        return exit_status
    except BrokenPipeError:
        # Whoever read the output has ended, as head does. What is left of it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt as interrupt:
        exit_status = 128 + signal.SIGINT
        line = str(interrupt) or "stopped"
    except Exception as error:
        exit_status = 1
        line = _line_of(error)
        if os.environ.get("APPLR_DEBUG"):
            traceback.print_exc()
    print(f"{program}: {line}", file=sys.stderr)
    return exit_status


def _line_of(error: Exception) -> str:
    """Return the line with which a command ends because of an error."""
    if isinstance(error, ModuleNotFoundError):
        how_to_install = absent(error.name)
        if how_to_install:
            return how_to_install
    if isinstance(error, ImportError):
        file_name = traceback.extract_tb(error.__traceback__)[-1].filename
        for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep):
            # A package of another Python that hides the one of this environment
            if folder and file_name.startswith(f"{folder}/"):
                return f"{error}: {file_name} is found by PYTHONPATH: unset PYTHONPATH"
    if isinstance(error, OSError):
        return str(error)  # It names the file, which says more than the line that opened it.
    return one_line(error)


def run_script(module: str, node: bool = False) -> NoReturn:
    """Import the module of a command, run its main() and exit the process, for scripts/__main__.py.

    Ctrl-C during the import, which takes seconds, exits silently. A missing Python package is
    reported in one line. The script's folder is removed from sys.path, because sim_bridge.py in
    this folder would hide the package sim_bridge. --help prints the USAGE of the module, or the
    docstring of a node without USAGE.

    Args:
        module: Full name of the module, such as "training.evaluate".
        node: Whether the module is a ROS node, which accepts no arguments except NAME:=VALUE.
    """
    if os.path.isfile(os.path.join(sys.path[0], "sim_bridge.py")):
        sys.path.pop(0)
    program = os.path.splitext(os.path.basename(sys.argv[0]))[0]
    sys.exit(run_main(lambda: _main_of(module, node), program))


def _main_of(module: str, node: bool) -> Optional[int]:
    """Import a module and run its main(), or print its usage."""
    usual_handler = signal.getsignal(signal.SIGINT)
    # A destructor of an imported library could swallow the KeyboardInterrupt.
    if usual_handler is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    loaded_module: Any = importlib.import_module(module)
    signal.signal(signal.SIGINT, usual_handler)

    usage = getattr(loaded_module, "USAGE", loaded_module.__doc__ if node else None)
    if usage and {"-h", "--help"} & set(sys.argv[1:]):
        print(usage)
        return 0

    arguments = [argument for argument in sys.argv[1:] if ":=" not in argument]
    if node and arguments:
        remedy = "give parameters as _NAME:=VALUE; --help lists them"
        raise ApplrError(f"unexpected arguments {' '.join(arguments)}: {remedy}")
    exit_status: Optional[int] = loaded_module.main()
    return exit_status
