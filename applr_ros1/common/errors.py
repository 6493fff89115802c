"""The base of the project's exceptions, and the wrappers that turn them into one line and an exit status."""

from __future__ import annotations

import difflib
import importlib
import os
import signal
import sys
import traceback
from typing import Any, Callable, Iterable, Optional

from applr_ros1.common.extras import absent


class ApplrError(ValueError):
    """A mistake that a user can put right. Its text is one line: what is wrong, which value, what to do."""


def did_you_mean(name: Any, known: Iterable[str]) -> str:
    """Return "did you mean NAME?" with the known name that is most like an unknown one; "" if none is."""
    close = difflib.get_close_matches(str(name), list(known), 1, 0.75)
    return f"did you mean {close[0]}?" if close else ""


def reason(error: BaseException) -> str:
    """Return the system's own words for an error, without its number and path."""
    return getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]


def one_line(error: BaseException) -> str:
    """Return an error in one line: the text of this package's own errors; of all others kind, text and place.

    The place is the file and line that raised the error: "KeyError: 'v' (my_method.py, line 9)".
    """
    if isinstance(error, ApplrError):
        return str(error)
    text = f"{type(error).__name__}: {_with_file(error)}"
    frames = traceback.extract_tb(error.__traceback__)
    if not frames or isinstance(error, SyntaxError):  # the latter names file and line itself
        return text
    return f"{text} ({os.path.basename(frames[-1].filename)}, line {frames[-1].lineno})"


def _with_file(error: BaseException) -> str:
    """Return the reason, after the file that it is about, where there is one."""
    where = f"{error.filename}: " if isinstance(error, OSError) and error.filename else ""
    return where + reason(error)


def run_main(main: Callable[[], Optional[int]], program: str) -> int:
    """Runs a command and returns its exit status.

    Every error becomes one line "PROGRAM: ..." on stderr, with exit status 1. Ctrl-C becomes 130, with the text of the
    KeyboardInterrupt if it has one. The environment variable APPLR_DEBUG adds the stack.

    Args:
        main: the command; returns an exit status, or None for 0.
        program: what the person called it, for instance "evaluate.py".
    """
    try:
        return main() or 0
    except KeyboardInterrupt as stopped:
        status, text = 128 + signal.SIGINT, str(stopped) or "stopped"
    except Exception as error:
        status, text = 1, absent(error.name) if isinstance(error, ModuleNotFoundError) else ""
        text = text or (_with_file(error) if isinstance(error, OSError) else one_line(error))
        if os.environ.get("APPLR_DEBUG"):
            traceback.print_exc()
    print(f"{program}: {text}", file=sys.stderr)
    return status


def run_script(module: str, node: bool = False) -> None:
    """Imports the module of a command, runs its main() and ends the process, for scripts/__main__.py.

    A Ctrl-C during the import, which takes seconds, ends the process without a word; a Python package that is missing
    is one line. The folder of the script is taken from sys.path: its sim_bridge.py would hide the package of that name.

    Args:
        module: such as "training.evaluate".
        node: whether it is a ROS node, which takes nothing but NAME:=VALUE. Other words end it with one line, before
            it does what nobody asked for; --help prints the module's USAGE, else a node's docstring.
    """
    if os.path.isfile(os.path.join(sys.path[0], "sim_bridge.py")):
        sys.path.pop(0)
    program = os.path.splitext(os.path.basename(sys.argv[0]))[0]
    sys.exit(run_main(lambda: _main_of(module, node), program))


def _main_of(module: str, node: bool) -> Optional[int]:
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # its exception would be lost in a library's destructor
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    loaded = importlib.import_module(module)
    signal.signal(signal.SIGINT, usual)
    usage = getattr(loaded, "USAGE", loaded.__doc__ if node else None)
    if usage and {"-h", "--help"} & set(sys.argv[1:]):
        print(usage)
        return 0
    words = [word for word in sys.argv[1:] if ":=" not in word]
    if node and words:
        raise ApplrError(f"{' '.join(words)}: give parameters as _NAME:=VALUE; --help says which there are")
    return loaded.main()
